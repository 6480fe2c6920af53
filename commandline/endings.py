"""How a command ends: exit codes and what it says; and groups of commands.

Exit code 0: all is well. 1: some scenes failed or are bad. 2: something is wrong with the input, the machine
or the disk, and one sentence on stderr says what. 70: a defect of NIGHT, with a traceback. 130 and 143: after
Ctrl-C and SIGTERM. With ``NIGHT_TRACEBACK=1`` a refusal shows where it came from. A command whose output
nobody reads any more, as in ``| head``, ends silently with 1.
"""

from __future__ import annotations

import difflib
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

from commandline.sentences import sentence_of
from commandline.streams import discard_unprinted, is_of_stdout, say
from disk import NightError

_DEFECT = 70  # EX_SOFTWARE of sysexits.h
_REPORT_IT = "This is a defect of NIGHT {}: please report it with the text above (see CONTRIBUTING.md)."
_NEARLY = 0.8  # of the letters of a misspelt command
_OURS = ("scenegen", "itof", "render", "model")  # rooms whose log a command shows
_OUTPUTS = ("out", "dataset")  # parameters that name where a command writes, the first that it has


class Refusal(click.ClickException):
    """A one-sentence error with exit code 2."""

    exit_code = 2


def _is_shown(record: logging.LogRecord) -> bool:
    """Whether a record of the log is for the user: libraries only when something is wrong."""
    return record.levelno >= logging.WARNING or record.name.split(".")[0] in _OURS


@contextmanager
def _ending(command: str, place: str = "") -> Iterator[None]:
    """Every exception that can end a command as message and exit code; click's own pass.

    `place` is where the command writes, for errors that do not say which file they are about.
    """
    try:
        yield
    except (click.exceptions.Exit, click.ClickException, click.Abort, BrokenPipeError):
        raise  # click ends silently where nobody reads what we print
    except KeyboardInterrupt:
        say("interrupted")
        sys.exit(128 + signal.SIGINT)
    except (NightError, MemoryError, OSError) as error:
        if os.environ.get("NIGHT_TRACEBACK"):
            say(traceback.format_exc())
        if isinstance(error, OSError) and is_of_stdout(error):
            raise Refusal(f"the result could not be printed on standard output: {error.strerror}") from None
        raise Refusal(sentence_of(error, command, place)) from None
    except Exception:  # of any kind: whatever input cannot cause is a defect
        say(traceback.format_exc() + _REPORT_IT.format(version("night-nlos")))
        sys.exit(_DEFECT)


class NightCommand(click.Command):
    """A command that ends as the module says, and that knows ``--version``."""

    def __init__(self, *args: Any, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        click.version_option(package_name="night-nlos")(self)

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run as a program: parse, work and exit."""
        try:
            return super().main(*args, **extra)
        except OSError as error:  # stderr did not take the message of the exception that ended the command
            sys.exit(getattr(error.__context__, "exit_code", Refusal.exit_code))
        finally:
            discard_unprinted()

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        """Parse the command line."""
        with _ending(self.name or ""):
            return super().make_context(*args, **extra)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options under their headings, in the order of the first of each; then the list of commands."""
        self.format_sections(ctx, formatter)
        if isinstance(self, click.Group):
            self.format_commands(ctx, formatter)

    def format_sections(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options under their headings."""
        sections: dict[str, list[tuple[str, str]]] = {"Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                sections.setdefault(getattr(parameter, "section", "Options"), []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)

    def invoke(self, ctx: click.Context) -> Any:
        """Do the work."""
        logging.basicConfig(level=logging.INFO, format="%(message)s")
        for handler in logging.getLogger().handlers:
            handler.addFilter(_is_shown)
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN:  # as `nohup` makes it
                signal.signal(number, lambda code, _: sys.exit(128 + code))  # so that `finally` runs
        place = next((str(ctx.params[name]) for name in _OUTPUTS if ctx.params.get(name)), "")
        with _ending(self.name or "", place):
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
            self._refuse_misspelt(args[0], ctx)
            args = [self.default, *args]
        return super().parse_args(ctx, args)

    def _refuse_misspelt(self, word: str, ctx: click.Context) -> None:
        """Refuse a word that is nearly one of the commands, and names no file or folder."""
        near = difflib.get_close_matches(word, self.commands, n=1, cutoff=_NEARLY)
        if near and not os.path.lexists(word):
            ctx.fail(f"No such command or folder {word!r}. Did you mean {near[0]!r}?")

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """The usage line of the default command; the others are listed below it."""
        return self.commands[self.default].collect_usage_pieces(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The default command's options, then the list of commands."""
        command = self.commands[self.default]
        if isinstance(command, NightCommand):
            command.format_sections(ctx, formatter)
        self.format_commands(ctx, formatter)
