"""The log of a run, ``renders/night-render.log``: the messages of `render`, and a line for each outcome."""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from errno import EEXIST
from pathlib import Path
from typing import TextIO

from render.farm.jobs import Outcome

LOG_FILE = "night-render.log"

log = logging.getLogger(__name__)


def log_outcome(outcome: Outcome, final: bool) -> None:
    """Log the answer to a job; `final` says that a failed scene is not tried again."""
    if outcome.kind == "failed":
        after = "given up" if final else "will be tried once more"
        log.info("%s failed on %s: %s (%s)", outcome.scene_id, outcome.worker, outcome.reason, after)
    elif outcome.kind == "rendered":
        made = outcome.attributes
        how = ", ".join(f"{name} {made[name]}" for name in ("lights", "hidden_error") if name in made)
        log.info(
            "%s rendered in %.2f s on %s (%s)",
            *(outcome.scene_id, outcome.seconds, outcome.worker, how or made.get("method", "")),
        )
        for line in outcome.log.splitlines():
            log.info("%s: %s", outcome.scene_id, line)


def logged(say: Callable[[str], object]) -> Callable[[str], None]:
    """A function that says a sentence and logs it."""

    def both(sentence: str) -> None:
        say(sentence)
        log.info(sentence)

    return both


@contextmanager
def log_file(file: Path) -> Iterator[None]:
    """Append the log messages of `render` to a file while the block runs.

    If the file cannot be written, or is a link or no plain file, the run goes on without it.
    """
    try:
        stream = _opened(file)
    except OSError:
        stream = None
    handler = logging.StreamHandler(stream) if stream is not None else logging.NullHandler()
    handler.setFormatter(logging.Formatter(f"%(asctime)s {os.getpid()} %(message)s"))
    handler.handleError = lambda record: None  # type: ignore[method-assign]
    logger = logging.getLogger("render")
    level, propagate = logger.level, logger.propagate
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.addHandler(handler)
    try:
        yield
    except BaseException as error:
        log.info("ended: %s", " ".join(str(error).split()) or type(error).__name__)
        raise
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagate
        handler.close()
        if stream is not None:
            with suppress(OSError):  # the disk is full
                stream.close()


def _opened(file: Path) -> TextIO:
    """The file, opened to append; follows no link and waits for no pipe."""
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(file, flags, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise FileExistsError(EEXIST, os.strerror(EEXIST), str(file))
    return os.fdopen(descriptor, "a", encoding="utf-8")
