"""The four scenes of the rendering benchmarks: roughness 0.3 to 0.9, one composite object."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from scenegen import Dataset, preset_from_dict, sample_scene
from scenegen.making.blender import BlenderMaker
from scenegen.making.generation import generate

SCENES = (("sphere", 0.3), ("cube", 0.6), ("concave_plane", 0.9), ("composite", 0.6))


@contextmanager
def four_scenes() -> Iterator[list[tuple[str, Dataset, str]]]:
    """(name, dataset, scene id) of each scene; the files are deleted at the end of the block."""
    with TemporaryDirectory() as folder:
        maker, found = BlenderMaker(), []
        for name, roughness in SCENES:
            data = {"dataset": {"count": 7}, "relay_wall": {"roughness": [roughness]}}
            preset = preset_from_dict(data, "benchmark")
            dataset = generate(Path(folder) / name, preset, maker, lambda: None)
            index = next(i for i in range(7) if sample_scene(preset, i).object_class == name)
            found.append((f"{name} {roughness:.1f}", dataset, dataset.ids()[index]))
        yield found
