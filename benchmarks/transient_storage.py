"""Size, time and memory of a transient on disk, in our layout with every lossless compression.

Renders one scene (a sphere, wall roughness 0.3) with many-light or with the path tracer. Writes it as the
scanlines of an EXR file (docs/reference/files.md), and in chunks (T, W, H) as the HDF5 file of
``render.products.tal_export``. Checks that every file has the rendered bits. The disk cache is warm, and
times do not include writing it to the disk. Memory is the peak of a process that only writes, or only
reads, 64 MiB of rows at a time. Run:

    .venv/bin/python benchmarks/transient_storage.py
    .venv/bin/python benchmarks/transient_storage.py --method path --spp 64
    .venv/bin/python benchmarks/transient_storage.py --size 160x120
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import Imath
import numpy as np
import OpenEXR

from itof import TransientLayout, TransientReader
from itof.exr.transient import TRANSIENT_CHANNEL
from render.options import ManyLightOptions, PathOptions
from render.rendering import Renderer
from render.settings import RenderSettings

EXR = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "ZSTD")  # PXR24, B44 and DWA are lossy for floats
HDF5 = {
    "none": {},
    "lzf": {"compression": "lzf"},
    "lzf + shuffle": {"compression": "lzf", "shuffle": True},
    "gzip 1": {"compression": "gzip", "compression_opts": 1},
    "gzip 1 + shuffle": {"compression": "gzip", "compression_opts": 1, "shuffle": True},
    "gzip 4 + shuffle": {"compression": "gzip", "compression_opts": 4, "shuffle": True},
}
CHUNKS = (250, 32, 8)
FLOAT = Imath.PixelType(Imath.PixelType.FLOAT)
WriteRows = Callable[[np.ndarray], None]


class ExrFile:
    """The layout of ``transient.exr``: a scanline is an image row, pixel by pixel, each with all its bins."""

    def __init__(self, compression: str) -> None:
        self.code = getattr(OpenEXR, f"{compression}_COMPRESSION")
        self.rows_at_once = 1

    @contextmanager
    def writer(self, file: Path, layout: TransientLayout) -> Iterator[WriteRows]:
        """Yield a function that appends rows."""
        header = OpenEXR.Header(layout.width * layout.bin_count, layout.height)
        header["channels"] = {TRANSIENT_CHANNEL: Imath.Channel(FLOAT)}
        header["compression"] = Imath.Compression(int(self.code))
        out = OpenEXR.OutputFile(str(file), header)
        yield lambda rows: out.writePixels({TRANSIENT_CHANNEL: rows.tobytes()}, len(rows))
        out.close()

    def read(self, file: Path, layout: TransientLayout, start: int, stop: int) -> np.ndarray:
        """(rows, W, T)."""
        source = OpenEXR.InputFile(str(file))
        data = source.channel(TRANSIENT_CHANNEL, FLOAT, start, stop - 1)
        source.close()
        return np.frombuffer(data, np.float32).reshape(stop - start, layout.width, layout.bin_count)


class Hdf5File:
    """The layout of the export for tal: (T, W, H) in chunks."""

    def __init__(self, options: dict) -> None:
        self.options = options
        self.rows_at_once = CHUNKS[2]

    @contextmanager
    def writer(self, file: Path, layout: TransientLayout) -> Iterator[WriteRows]:
        """Yield a function that appends rows."""
        shape = (layout.bin_count, layout.width, layout.height)
        done = 0
        with h5py.File(file, "w") as out:
            bins = out.create_dataset(
                "H", shape, np.float32, chunks=tuple(map(min, shape, CHUNKS)), **self.options
            )

            def write(rows: np.ndarray) -> None:
                nonlocal done
                bins[:, :, done : done + len(rows)] = rows.transpose(2, 1, 0)
                done += len(rows)

            yield write

    def read(self, file: Path, layout: TransientLayout, start: int, stop: int) -> np.ndarray:
        """(rows, W, T)."""
        with h5py.File(file) as source:
            return source["H"][:, :, start:stop].transpose(2, 1, 0)


def candidates() -> dict[str, ExrFile | Hdf5File]:
    """All layouts by name, without compressions that this OpenEXR does not have."""
    exr = {f"EXR {name}": ExrFile(name) for name in EXR if hasattr(OpenEXR, f"{name}_COMPRESSION")}
    return exr | {f"HDF5 {name}": Hdf5File(options) for name, options in HDF5.items()}


def raw_blocks(raw: Path, layout: TransientLayout, step: int) -> Iterator[tuple[int, np.ndarray]]:
    """First row and (rows, W, T) values of the uncompressed file, in blocks of `step` rows."""
    with raw.open("rb") as source:
        for start in range(0, layout.height, step):
            rows = min(step, layout.height - start)
            values = np.fromfile(source, np.float32, rows * layout.width * layout.bin_count)
            yield start, values.reshape(rows, layout.width, layout.bin_count)


def measure_write(name: str, raw: Path, layout: TransientLayout, file: Path) -> tuple[float, float]:
    """Seconds to write the file, and peak memory of this process in MB."""
    kind = candidates()[name]
    step = max(1, layout.rows_per_block // kind.rows_at_once) * kind.rows_at_once
    blocks = raw_blocks(raw, layout, step)
    seconds = -time.perf_counter()
    with kind.writer(file, layout) as write:
        seconds += time.perf_counter()
        for _, rows in blocks:
            started = time.perf_counter()
            write(rows)
            seconds += time.perf_counter() - started
        seconds -= time.perf_counter()
    return seconds + time.perf_counter(), peak_mb()


def measure_read(name: str, raw: Path, layout: TransientLayout, file: Path) -> tuple[float, float, float]:
    """Seconds to read all rows and to read one row, and peak memory of this process in MB.

    Raises
    ------
    ValueError : the file does not have the rendered bits.
    """
    kind = candidates()[name]
    step = max(1, layout.rows_per_block // kind.rows_at_once) * kind.rows_at_once
    middle = layout.height // 2
    started = time.perf_counter()
    kind.read(file, layout, middle, middle + 1)
    one = time.perf_counter() - started
    seconds = 0.0
    for start, rows in raw_blocks(raw, layout, step):
        started = time.perf_counter()
        found = np.ascontiguousarray(kind.read(file, layout, start, start + len(rows)))
        seconds += time.perf_counter() - started
        if not np.array_equal(found.view(np.uint32), rows.view(np.uint32)):
            raise ValueError(f"{name} changed the bits of rows from {start}")
    return seconds, one, peak_mb()


def peak_mb() -> float:
    """Peak resident memory of this process in MB. getrusage would include the parent before the exec."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1e3


def alone(function: Callable, *arguments: object) -> tuple:
    """Call a function in a separate process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def unpack(transient: Path, raw: Path) -> tuple[TransientLayout, float]:
    """Write the uncompressed values; return their layout and the share of bins with light."""
    lit = 0
    with TransientReader(transient) as reader, raw.open("wb") as out:
        for rows in reader.row_blocks():
            rows.tofile(out)
            lit += np.count_nonzero(rows)
        layout = reader.layout
    return layout, lit / (layout.width * layout.height * layout.bin_count)


def render(settings: RenderSettings, raw: Path) -> tuple[TransientLayout, float]:
    """Render the first of the seven scenes and unpack its transient."""
    # Imported late: a process that has loaded bpy cannot spawn another (docs/science/design.md, Blender).
    from seven_scenes import seven_scenes

    with seven_scenes() as scenes:
        _, dataset, scene_id = scenes[0]
        Renderer(dataset, settings).render(scene_id)
        return unpack(dataset.render_folder(scene_id) / "transient.exr", raw)


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--size", default="320x240")
    arguments.add_argument("--method", default="many-light")
    arguments.add_argument("--spp", type=int, default=64)
    arguments.add_argument("--transient", type=Path, help="measure this file, render nothing")
    given = arguments.parse_args()
    width, height = map(int, given.size.split("x"))
    settings = RenderSettings(
        product="both",
        options=PathOptions(spp=given.spp) if given.method == "path" else ManyLightOptions(),
        resolution=(width, height),
    )
    with TemporaryDirectory() as folder:
        raw, file = Path(folder) / "raw", Path(folder) / "file"
        made = alone(unpack, given.transient, raw) if given.transient else alone(render, settings, raw)
        layout, share = made
        origin = given.transient or f"{given.method}" + (
            f", {given.spp} spp" if given.method == "path" else ""
        )
        print(f"{layout.width} x {layout.height} x {layout.bin_count} float32, {origin}: ", end="")
        print(f"{raw.stat().st_size / 1e6:.0f} MB, {share:.0%} of the bins lit\n")
        print("| layout | MB | write s | read s | one row ms | peak MB write, read |")
        print("|---|---|---|---|---|---|")
        for name in candidates():
            write_s, write_mb = alone(measure_write, name, raw, layout, file)
            size_mb = file.stat().st_size / 1e6
            read_s, row_s, read_mb = alone(measure_read, name, raw, layout, file)
            print(
                f"| {name} | {size_mb:.1f} | {write_s:.2f} | {read_s:.2f} | {row_s * 1e3:.0f} "
                f"| {write_mb:.0f}, {read_mb:.0f} |"
            )
            sys.stdout.flush()
            file.unlink()


if __name__ == "__main__":
    main()
