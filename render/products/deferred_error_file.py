"""A file for the HDF5 library that defers errors of writing, and signals.

HDF5 can crash the process when it cannot write, as on a full disk or when a signal raises an exception. Here
the first error is kept, and what found no room on the disk is held in memory, so that HDF5 reads back what it
wrote and closes the file as usual. The writer asks for the error now and then, and stops.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from processes import deferred_signals

if TYPE_CHECKING:
    import h5py


class DeferredErrorFile(io.RawIOBase):
    """A new file for writing and reading.

    Attributes
    ----------
    error : the first error of writing; None if there was none.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.error: OSError | None = None
        self._file = path.open("w+b", buffering=0)
        self._at = self._end = 0
        self._lost: list[tuple[int, bytes]] = []  # offset and bytes of writes that failed, in their order

    def raise_error(self) -> None:
        """Raise the first error of writing, if there was one."""
        if self.error is not None:
            raise self.error

    def write(self, data: Any) -> int:
        """Write all of `data`."""
        rest = memoryview(data).cast("B")
        count = len(rest)
        try:
            while rest and self.error is None:
                done = os.pwrite(self._file.fileno(), rest, self._at)
                self._at += done
                rest = rest[done:]
        except OSError as error:
            self.error = error
        if rest:
            self._lost.append((self._at, bytes(rest)))
            self._at += len(rest)
        self._end = max(self._end, self._at)
        return count

    def readinto(self, buffer: Any) -> int:
        """Read what was written, also where writing failed; what was never written is zero."""
        target = memoryview(buffer).cast("B")
        count = max(0, min(len(target), self._end - self._at))
        found = os.pread(self._file.fileno(), count, self._at)
        target[:count] = found.ljust(count, b"\0")
        for start, lost in self._lost:
            first, last = max(start, self._at), min(start + len(lost), self._at + count)
            if first < last:
                target[first - self._at : last - self._at] = lost[first - start : last - start]
        self._at += count
        return count

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._end}[whence]
        return self._at

    def tell(self) -> int:
        """The place at which the next byte is read or written."""
        return self._at

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        self._end = self._at if size is None else size
        try:
            self._file.truncate(self._end)
        except OSError as error:
            self.error = self.error or error
        return self._end

    def readable(self) -> bool:
        """It is."""
        return True

    def writable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def close(self) -> None:
        """Close the file."""
        try:
            self._file.close()
        except OSError as error:  # some file systems say only now that the disk is full
            self.error = self.error or error
        super().close()


@contextmanager
def hdf5_file(path: Path) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """A new HDF5 file, and a function to call between two steps of writing.

    The function raises the `OSError` of a write that failed, and handles signals. So does the block's end.
    """
    import h5py

    with deferred_signals() as handle_signals:
        with DeferredErrorFile(path) as stream, h5py.File(stream, "w") as file:

            def stop_if_needed() -> None:
                handle_signals()
                stream.raise_error()

            yield file, stop_if_needed
        stream.raise_error()
