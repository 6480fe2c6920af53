"""Signals that wait until no exception can do harm.

The handlers of commands raise exceptions (`commandline.endings`). An exception must not cross a C library
that calls Python back: HDF5 then crashes the process, and Blender loses the exception.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Final

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def deferred_signals() -> Iterator[Callable[[], None]]:
    """Signals that end a command are only noted while the block runs, and handled at its end.

    The function that is yielded handles those that came so far; long work calls it between two steps. Signals
    without a handler in Python, such as ignored ones, are left alone.
    """
    noted: list[int] = []
    in_main = threading.current_thread() is threading.main_thread()  # others get no signals
    handlers = {int(n): handler for n in _ENDING if in_main and callable(handler := signal.getsignal(n))}

    def handle_noted() -> None:
        while noted:
            number = noted.pop(0)
            handlers[number](number, None)

    try:
        with ExitStack() as stack:
            for number, handler in handlers.items():
                stack.callback(signal.signal, number, handler)
                signal.signal(number, lambda number, _: noted.append(number))
            yield handle_noted
    finally:
        handle_noted()
