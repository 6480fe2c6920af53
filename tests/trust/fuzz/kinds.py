"""A kind of file that the commands read: a sample, how it is damaged, and the command that reads it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Reader:
    """A command that reads a file.

    Attributes
    ----------
    command : command line; ``{file}`` stands for the file.
    writes : patterns of paths that it may write.
    results : patterns of paths that are its result, if these are not all that it writes.
    named : words of which a refusal has one, where it does not name the file itself.
    """

    command: str
    writes: tuple[str, ...] = ("new",)
    results: tuple[str, ...] = ()
    named: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kind:
    """One kind of file, and one command that reads it.

    Attributes
    ----------
    file : the sample, within ``work`` of `samples`.
    damages : functions of `damage` and `damage_formats`.
    share : inputs, relative to `conftest.INPUTS`; the kinds of one format have 1 or more together.
    vouched : whether a checksum protects the file, so that a result may only be that of the undamaged file.
    forge : function of `forging`, for a file whose records a stranger has made to match.
    other : another valid file of this kind, for splices.
    """

    name: str
    file: str
    damages: tuple[Callable, ...]
    reader: Reader
    share: float
    vouched: bool = False
    forge: Callable[[Path, bytes], dict[str, bytes]] | None = None
    other: str = ""

    @property
    def words(self) -> list[str]:
        """The command line."""
        return self.reader.command.format(file=self.file).split()

    @property
    def names(self) -> tuple[str, ...]:
        """Words of which a refusal has one."""
        return (Path(self.file).name, *self.reader.named)

    @property
    def results(self) -> tuple[str, ...]:
        """Patterns of paths that are the command's result."""
        return self.reader.results or self.reader.writes
