"""Interruption by Ctrl-C or SIGTERM, delayed until the state of the training is on disk."""

from __future__ import annotations

import contextlib
import logging
import signal
import sys
import threading
from types import FrameType, TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_log = logging.getLogger(__name__)


class Interruption:
    """Context in which the first SIGINT or SIGTERM is only noted; a second one has its usual effect.

    A signal that the process ignores stays ignored, as SIGINT in a background job of a script.

    Attributes
    ----------
    signal : number of the noted signal, or None.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._before: dict[int, signal._HANDLER] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():  # only this thread may set handlers
            heeded = [number for number in SIGNALS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
            self._before = {number: signal.signal(number, self._note) for number in heeded}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def end(self) -> None:
        """End the process: KeyboardInterrupt after SIGINT, exit code 128 + number after another signal."""
        if self.signal == signal.SIGINT:
            raise KeyboardInterrupt
        if self.signal is not None:
            sys.exit(128 + self.signal)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        self._restore()
        with contextlib.suppress(RuntimeError):  # of a stream that the signal found in the middle of a write
            _log.info(
                "stopping after this batch with a checkpoint; a second signal stops at once without one"
            )

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}
