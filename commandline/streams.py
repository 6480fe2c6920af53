"""Printing on standard streams that may take nothing: a full disk, a closed pipe."""

from __future__ import annotations

import os
import sys
import traceback
from contextlib import suppress

import click


def say(sentence: str) -> None:
    """Print on stderr what is no result. Where stderr takes nothing, the work goes on."""
    with suppress(OSError):
        click.echo(sentence, err=True)


def is_of_stdout(error: OSError) -> bool:
    """Whether printing on stdout raised this error."""
    return any(frame.f_code is click.echo.__code__ for frame, _ in traceback.walk_tb(error.__traceback__))


def discard_unprinted() -> None:
    """Discard what the streams do not take; at exit, Python would end with a code of its own for it."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with suppress(OSError):  # a stream without a file
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
