"""The question before a command deletes what only much work brings back."""

from __future__ import annotations

import sys

import click

from commandline.endings import Refusal

YES = click.option("--yes", is_flag=True, help="Delete without asking.")


def confirm_deletion(what: str, yes: bool) -> None:
    """Ask whether to delete `what`; `Refusal` after another answer than yes, and where nobody can be asked.

    Parameters
    ----------
    what : things to be deleted, and how much they are.
    yes : whether ``--yes`` was given; then nobody is asked.
    """
    if yes:
        return
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):
        raise Refusal(f"this would delete {what}: give --yes to delete without a question")
    try:
        agreed = click.confirm(f"Delete {what}?", err=True)
    except click.Abort:
        agreed = False
    if not agreed:
        raise Refusal("nothing was deleted")
