"""Progress of long work on stderr: a bar in a terminal, a line now and then in a log file."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Protocol, Self, TextIO

_SHARE = 0.05  # of the work, after which a line is due
_SHORTEST_S, _LONGEST_S = 1.0, 30.0  # between two lines
_TOGETHER_S = 0.1  # between units that were done at once, as a batch of scenes


class Progress(Protocol):
    """What counts the work that is done; `tqdm`'s bar is one."""

    def update(self, n: int = 1) -> None:
        """Count `n` more units of work."""

    def set_description(self, desc: str, refresh: bool = True) -> object:
        """Name the work that is being done now."""

    def set_postfix(self, *, refresh: bool = True, **values: object) -> object:
        """Replace the values that are shown after the numbers."""


class Lines:
    """Prints lines like ``render: 120 of 1344 scenes, 2.1 scenes/s, 9 min left (failed=0)``.

    A line appears when 5 % more of the work are done, but at most once a second, and when 30 s have passed
    and any work is done. The first updates come late, after programs were loaded and compiled; the pace is
    that of the others. Work of less than a second prints nothing. A stream that takes no more lines stops
    nothing: the work goes on.

    Parameters
    ----------
    total : units of work; None when it is not known.
    unit : name of one of them.
    description : name of the work.
    initial : units that were done before this work began.
    stream : where to print; None for nowhere.
    clock : seconds from some moment on.
    """

    def __init__(
        self,
        total: int | None,
        unit: str,
        description: str = "",
        *,
        initial: int = 0,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total, self._unit, self._description = total, unit, description
        self._initial = self._done = self._printed = initial
        self._stream, self._clock = stream, clock
        self._began_s = self._printed_s = clock()
        self._first: tuple[float, int] | None = None  # when the first updates came, and what was done then
        self._values = ""
        self._began_to_print = False

    def update(self, n: int = 1) -> None:
        """Count `n` more units of work."""
        self._done += n
        now_s = self._clock()
        first_s = now_s if self._first is None else self._first[0]
        if now_s - first_s <= _TOGETHER_S:
            self._first = (first_s, self._done)
        waited_s = now_s - self._printed_s
        if waited_s < _SHORTEST_S or self._done == self._printed:
            return
        share_is_done = self._total is not None and self._done - self._printed >= _SHARE * self._total
        if share_is_done or waited_s >= _LONGEST_S:
            self._print()

    def set_description(self, desc: str, refresh: bool = True) -> None:
        """Name the work that is being done now."""
        self._description = desc

    def set_postfix(self, *, refresh: bool = True, **values: object) -> None:
        """Replace the values that are shown after the numbers."""
        self._values = ", ".join(f"{name}={value}" for name, value in values.items())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._began_to_print and self._done != self._printed:
            self._print()

    def _print(self) -> None:
        self._printed, self._printed_s = self._done, self._clock()
        self._began_to_print = True
        if self._stream is not None:
            with suppress(OSError, ValueError):  # a pipe or file that was closed
                print(self._line(), file=self._stream, flush=True)

    def _line(self) -> str:
        of = "" if self._total is None else f" of {self._total}"
        parts = [f"{self._done}{of} {self._unit}{'' if of == '' and self._done == 1 else 's'}"]
        elapsed_s, is_done = self._printed_s - self._began_s, self._done == self._total
        from_s, before = (self._began_s, self._initial) if is_done else self._first or (0.0, self._done)
        if self._done > before and self._printed_s > from_s:
            pace = (self._done - before) / (self._printed_s - from_s)
            parts.append(_pace(pace, self._unit))
            if self._total is not None and not is_done:
                parts.append(f"{duration((self._total - self._done) / pace)} left")
        if self._total is None or is_done:
            parts.append(f"{duration(elapsed_s)} {'in all' if is_done else 'so far'}")
        name = f"{self._description}: " if self._description else ""
        return name + ", ".join(parts) + (f" ({self._values})" if self._values else "")


def showing_progress(
    total: int | None, unit: str, description: str = "", *, initial: int = 0, show: bool = True
) -> AbstractContextManager[Progress]:
    """Show the progress of work on stderr: a bar in a terminal, `Lines` elsewhere; nothing without `show`.

    Parameters
    ----------
    total : units of work; None when it is not known.
    unit : name of one of them.
    description : name of the work.
    initial : units that were done before this work began.
    """
    if show and sys.stderr is not None and sys.stderr.isatty():
        from tqdm import tqdm  # which the processes that read measurements need not load

        bar: AbstractContextManager[Progress] = tqdm(
            total=total, unit=unit, desc=description or None, initial=initial
        )
        return bar
    return Lines(total, unit, description, initial=initial, stream=sys.stderr if show else None)


def duration(seconds: float) -> str:
    """A time span in the unit that suits it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.1f} days"


def _pace(per_second: float, unit: str) -> str:
    if per_second < 1:
        return f"{1 / per_second:.1f} s/{unit}"
    return f"{per_second:.1f} {unit}s/s"
