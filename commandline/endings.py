"""How a command ends: exit codes and what it says; and groups of commands.

Exit code 0: all is well. 1: some scenes failed or are bad. 2: something is wrong with the input, the machine
or the disk, and one sentence on stderr says what. 70: a defect of NIGHT, with a traceback. 130 and 143: after
Ctrl-C and SIGTERM. With ``NIGHT_TRACEBACK=1`` a refusal shows where it came from. A command whose output
nobody reads any more, as in ``| head``, ends silently with 1.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

import click

from itof import ImageFileError
from scenegen import NightError

_DEFECT = 70  # EX_SOFTWARE of sysexits.h


class Refusal(click.ClickException):
    """A one-sentence error with exit code 2."""

    exit_code = 2


@contextmanager
def _ending() -> Iterator[None]:
    """Every exception that can end a command as message and exit code; click's own pass."""
    try:
        yield
    except (click.exceptions.Exit, click.ClickException, click.Abort, BrokenPipeError):
        raise  # click ends silently where nobody reads what we print
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        sys.exit(128 + signal.SIGINT)
    except (NightError, ImageFileError, MemoryError, OSError) as error:
        if os.environ.get("NIGHT_TRACEBACK"):
            traceback.print_exc()
        raise Refusal(_sentence(error)) from None
    except Exception:  # of any kind: whatever input cannot cause is a defect
        traceback.print_exc()
        click.echo(
            f"This is a defect of NIGHT {version('night-nlos')}: please report it with the text above (see "
            "CONTRIBUTING.md).",
            err=True,
        )
        sys.exit(_DEFECT)


class NightCommand(click.Command):
    """A command that ends as the module says, and that knows ``--version``."""

    def __init__(self, *args: Any, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        click.version_option(package_name="night-nlos")(self)

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        """Parse the command line."""
        with _ending():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Do the work."""
        logging.basicConfig(level=logging.INFO, format="%(message)s")
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that `finally` runs
        with _ending():
            return super().invoke(ctx)


class NightGroup(NightCommand, click.Group):
    """A group of such commands."""

    command_class = NightCommand


class DefaultGroup(NightGroup):
    """A group, one command of which (`default`) is meant where the first word names none of them."""

    def __init__(self, *args: Any, default: str, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.default = default

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command's name before what cannot be meant for the group."""
        if args and args[0] not in self.commands and args[0] not in ("--help", "--version"):
            args = [self.default, *args]
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """The usage line of the default command; the others are listed below it."""
        return self.commands[self.default].collect_usage_pieces(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The default command's options, then the list of commands."""
        parameters = self.commands[self.default].get_params(ctx)
        options = [parameter for parameter in parameters if isinstance(parameter, click.Option)]
        records = [record for option in options if (record := option.get_help_record(ctx)) is not None]
        with formatter.section("Options"):
            formatter.write_dl(records)
        self.format_commands(ctx, formatter)


def say(sentence: str) -> None:
    """Print on stderr what is no result."""
    click.echo(sentence, err=True)


def _sentence(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    if isinstance(error, MemoryError):
        return f"out of memory {error}".strip() + ": use a smaller resolution, batch or bin_count"
    return " ".join(str(error).split()) or type(error).__name__
