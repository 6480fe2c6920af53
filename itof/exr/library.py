"""OpenEXR: files are written and read through this module, the only one that imports the library.

A file is opened for reading only after `itof.exr.header` has checked its structure, so that a damaged or
hostile file is refused and cannot crash the process. What OpenEXR prints is discarded, and each of its errors
becomes one sentence with the name of the file.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import Imath
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from disk.whole_writing import errno_of_writing
from itof.exr.header import ImageFileError, UnsupportedImageError, read_structure
from processes import silenced

ATTRIBUTE_PREFIX = "night."
_FLOAT = Imath.PixelType(Imath.PixelType.FLOAT)
_ERRORS_OF_WRITING = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS, errno.ENOENT, errno.ENOTDIR),
    *(errno.EISDIR, errno.ENAMETOOLONG, errno.EMFILE),
)


@contextmanager
def compressing_with_threads(count: int) -> Iterator[None]:
    """Compress EXR files with `count` threads of OpenEXR inside; the files do not depend on it.

    Outside, OpenEXR has no threads and compresses in the thread that writes. A process that is forked while
    OpenEXR has threads gets none of them and waits for them for ever when it opens an EXR file.
    """
    OpenEXR.set_global_thread_count(count if count > 1 else 0)
    try:
        yield
    finally:
        OpenEXR.set_global_thread_count(0)


class ExrOutput:
    """A new EXR file with FLOAT channels and text attributes.

    Parameters
    ----------
    packed : with lossless compression (ZIPS), or none.

    Raises
    ------
    OSError : the file cannot be written; the error has the name of the file.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        channels: Sequence[str],
        attributes: Mapping[str, str],
        *,
        packed: bool = True,
    ) -> None:
        self._path = path
        try:
            str(path).encode()
        except UnicodeEncodeError:  # on which OpenEXR crashes the process
            raise OSError(errno.EILSEQ, "an EXR file needs a name that is UTF-8", str(path)) from None
        header = OpenEXR.Header(*size)
        header["channels"] = {name: Imath.Channel(_FLOAT) for name in channels}
        method = Imath.Compression.ZIPS_COMPRESSION if packed else Imath.Compression.NO_COMPRESSION
        header["compression"] = Imath.Compression(method)
        texts = {ATTRIBUTE_PREFIX + name: text.encode() for name, text in attributes.items()}
        with self._errors():
            self._file = OpenEXR.OutputFile(str(path), header | texts)

    def write(self, pixels: Mapping[str, NDArray[np.float32]], rows: int) -> None:
        """Append rows; `pixels` has the values of each channel, contiguous."""
        with self._errors():
            self._file.writePixels(dict(pixels), rows)

    def close(self, *, complete: bool) -> None:
        """Close the file; if it should be `complete`, it is checked.

        OpenEXR writes the last bytes when it closes, and says nothing if there was no room for them.
        """
        self._file.close()
        if not complete:
            return
        try:
            with self._path.open("rb") as stream:
                read_structure(stream)
        except ImageFileError:
            number = errno_of_writing(self._path)
            raise OSError(number, os.strerror(number), str(self._path)) from None

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Errors of OpenEXR, in the words of the system."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            reason = " ".join(str(error).split()).rstrip(".")
            known = {os.strerror(number): number for number in _ERRORS_OF_WRITING}
            words = reason.rpartition(". ")[2]
            if words in known:
                raise OSError(known[words], words, str(self._path)) from None
            raise OSError(errno.EIO, reason, str(self._path)) from None


class ExrInput:
    """An EXR file for reading, whose structure has been checked.

    Parameters
    ----------
    advice : what to do where the file is damaged; it ends the sentence of an error.

    Attributes
    ----------
    structure : channels and size of the image.
    texts : the text attributes of NIGHT, by name.

    Raises
    ------
    ImageFileError : the file is missing, damaged or no EXR file.
    """

    def __init__(self, path: Path, advice: str = "") -> None:
        self._path, self._advice = path, advice
        with self._errors():
            is_there, is_folder = path.is_file(), path.is_dir()  # fail in a folder that cannot be searched
        if not is_there:
            raise ImageFileError(f"{path} {'is a folder' if is_folder else 'does not exist'}")
        with self._errors(), path.open("rb") as stream:
            self.structure = read_structure(stream)
            self._file = OpenEXR.InputFile(_name_of(stream, path))
        self.texts = {
            name.removeprefix(ATTRIBUTE_PREFIX): text
            for name, text in self.structure.texts.items()
            if name.startswith(ATTRIBUTE_PREFIX)
        }

    def rows(self, names: Sequence[str], start: int, stop: int) -> list[NDArray[np.float32]]:
        """Rows `start` to `stop` - 1 of channels, each (rows, W) float32."""
        first = self.structure.first_row + start
        with self._errors():
            data = self._file.channels(list(names), _FLOAT, first, first + stop - start - 1)
            return [np.frombuffer(values, np.float32).reshape(stop - start, -1) for values in data]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def refusal(self, sentence: str) -> ImageFileError:
        """The error that says `sentence`, which names the file, and then what to do."""
        return ImageFileError(f"{sentence}: {self._advice}" if self._advice else sentence)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Every error of reading as an `ImageFileError` of one sentence."""
        try:
            with silenced(2):
                yield
        except MemoryError:
            raise ImageFileError(f"{self._path} does not fit into the memory that is free") from None
        except UnsupportedImageError as error:
            raise ImageFileError(f"{self._path} cannot be used: {error}") from None
        except (OSError, RuntimeError, TypeError, ValueError) as error:
            if isinstance(error, OSError) and error.errno is not None:  # not of OpenEXR
                raise ImageFileError(f"{self._path} cannot be read: {error.strerror}") from None
            reason = re.sub(r'"/dev/fd/[0-9]+"', "it", " ".join(str(error).split())).rstrip(".")
            raise self.refusal(f"{self._path} is damaged or no EXR file ({reason})") from None


def _name_of(stream: BinaryIO, path: Path) -> str:
    """A name by which OpenEXR opens the very file that was checked.

    That of its descriptor, where the system has such names: it stays the same file when another one is put in
    its place, and it is ASCII. OpenEXR crashes the process on names that are not UTF-8.
    """
    name = f"/dev/fd/{stream.fileno()}"
    return name if Path(name).exists() else str(path)
