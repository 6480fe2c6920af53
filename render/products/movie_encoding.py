"""Encodes the pictures of a movie as an MP4 file."""

from __future__ import annotations

import errno
import os
import signal
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

from render.products.conversion import ExportError

if TYPE_CHECKING:
    from PIL.Image import Image as Picture


def encode_mp4(path: Path, pictures: Iterator[Picture], frames_per_second: int) -> None:
    """Write an H.264 movie with the ffmpeg program of imageio_ffmpeg.

    Parameters
    ----------
    pictures : RGB pictures of equal size; width and height are even.

    Raises
    ------
    ExportError : ffmpeg failed; the message has its own error.
    OSError : the disk is full.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    first = next(pictures)
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{first.width}x{first.height}"]
    h264 = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"]
    encoded = [*h264, f"file:{path}"]  # without "file:", a colon in the name would mean a protocol
    command = [get_ffmpeg_exe(), "-v", "error", "-y", *raw, "-r", str(frames_per_second), "-i", "-"]
    # The writer of imageio_ffmpeg does not report a failure of ffmpeg and does not close its pipes.
    with TemporaryFile() as complaint:
        try:
            # The program comes from imageio_ffmpeg; our arguments are numbers and the file name.
            with Popen([*command, *encoded], stdin=PIPE, stdout=DEVNULL, stderr=complaint) as ffmpeg:  # noqa: S603
                try:
                    for picture in chain([first], pictures):
                        ffmpeg.stdin.write(picture.tobytes())  # type: ignore[union-attr]
                except BaseException:
                    ffmpeg.kill()
                    raise
        except BrokenPipeError:
            pass  # ffmpeg ended early; its error is raised below
        complaint.seek(0)
        reason = " ".join(complaint.read().decode(errors="replace").split())
    if ffmpeg.returncode == -signal.SIGXFSZ:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    if ffmpeg.returncode != 0:
        for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            if os.strerror(number) in reason:
                raise OSError(number, os.strerror(number), str(path))
        raise ExportError(
            f"ffmpeg could not encode the movie: {reason or f'it ended with code {ffmpeg.returncode}'}"
        )
