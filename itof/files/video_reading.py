"""The frames of an MKV file whose grey numbers have more than 8 bits, by the program ffmpeg.

A video stream is the array ``stream0``, ``stream1``, ... (frame, row, column), as ffmpeg counts the video
streams of the file. ffmpeg takes the file for nothing but Matroska, and opens no other file and no network.
"""

from __future__ import annotations

import re
from os import SEEK_END
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen, run
from tempfile import TemporaryFile
from typing import Final

import numpy as np

from disk.extras import MissingPackageError, need
from itof.arrays import Numbers
from itof.files.array_claims import Claims, RefusedError, check_claim

_STREAM: Final = re.compile(
    r"^  Stream #0:\d+.*?: Video: .*?, (?P<kind>\w+)(?:\([^)]*\))?, (?P<width>\d+)x(?P<height>\d+)",
    re.MULTILINE,
)
_KIND: Final = re.compile(r"gray(?:9|1[0-6])[lb]e")


def read_video(path: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Numbers], list[str]]:
    """The streams among `wanted` that a file has, and the names of all.

    Raises
    ------
    RefusedError : ffmpeg is not installed, it is no MKV file, or a stream has colours, 8 bits or too many
        frames.
    """
    try:
        need("export", ("imageio_ffmpeg",), "reading an .mkv file")
    except MissingPackageError as error:
        raise RefusedError(f"{path}: {error}") from None
    from imageio_ffmpeg import get_ffmpeg_exe

    start = [get_ffmpeg_exe(), "-nostdin", "-hide_banner", "-protocol_whitelist", "file"]
    start += ["-f", "matroska", "-i", f"file:{path.resolve()}"]
    told = run(start, stdin=DEVNULL, capture_output=True, check=False).stderr.decode(errors="replace")  # noqa: S603
    streams = {f"stream{place}": match for place, match in enumerate(_STREAM.finditer(told))}
    if not streams:
        raise RefusedError(f"{path} cannot be read: it is damaged or no MKV file with video")
    claims = Claims(path)
    found = {}
    for place, (name, match) in enumerate(streams.items()):
        if name in wanted:
            if not _KIND.fullmatch(match["kind"]):
                raise RefusedError(
                    f"{path}: {name} has numbers of the kind {match['kind']}, and only grey ones of more "
                    "than 8 bits are read"
                )
            shape = (int(match["height"]), int(match["width"]))
            kind = f"{match['kind'][:-2]}le"
            whole = ["-map", f"0:v:{place}", "-fps_mode", "passthrough"]
            command = [start[0], "-loglevel", "error", *start[1:], *whole]
            command += ["-f", "rawvideo", "-pix_fmt", kind, "-"]
            found[name] = _frames(claims, name, command, shape)
    return found, list(streams)


def _frames(claims: Claims, name: str, command: list[str], shape: tuple[int, int]) -> Numbers:
    """The frames (N, H, W) that ffmpeg writes, until they are too many for the memory."""
    frames, size = list[Numbers](), claims.path.stat().st_size
    check_claim(claims.path, name, np.dtype("<u2"), shape, size)
    count = 2 * shape[0] * shape[1]
    with TemporaryFile() as told, Popen(command, stdin=DEVNULL, stdout=PIPE, stderr=told) as program:  # noqa: S603
        try:
            while len(part := program.stdout.read(count)) == count > 0:  # type: ignore[union-attr]
                claims.add(name, np.dtype("<u2"), shape, size)
                frames.append(np.frombuffer(part, "<u2").reshape(shape))
        except BaseException:
            program.kill()
            raise
        is_damaged = program.wait() != 0 or told.seek(0, SEEK_END) > 0  # it goes on after what it tells
    if not frames or part or is_damaged:
        raise RefusedError(f"{claims.path}: {name} is damaged: ffmpeg reads {len(frames)} whole frames of it")
    return np.stack(frames)
