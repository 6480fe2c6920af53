"""The scenes of the rendering benchmarks: one of each class, and many of the paper's preset.

A separate process makes them. So the process that measures has not loaded Blender, and can start others.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenegen import Dataset, open_dataset, preset_from_dict

# Class and roughness of the wall. The first three are those of docs/images/hidden_signal.png.
SCENES = (
    ("sphere", 0.3),
    ("cube", 0.6),
    ("concave_plane", 0.9),
    ("cylinder", 0.4),
    ("cone", 0.5),
    ("parallelepiped", 0.8),
    ("composite", 0.6),
)


@contextmanager
def seven_scenes(names: tuple[str, ...] = ()) -> Iterator[list[tuple[str, Dataset, str]]]:
    """(name, dataset, scene id) of each scene; the files are deleted at the end of the block.

    Parameters
    ----------
    names : classes; empty for all seven.
    """
    with TemporaryDirectory() as folder:
        chosen = [(name, roughness) for name, roughness in SCENES if not names or name in names]
        datasets = made_datasets(
            {
                Path(folder) / name: {"dataset": {"count": 7}, "relay_wall": {"roughness": [roughness]}}
                for name, roughness in chosen
            }
        )
        yield [
            (f"{name.replace('_', ' ')} ({roughness:.1f})", dataset, _first_of(dataset, name))
            for (name, roughness), dataset in zip(chosen, datasets, strict=True)
        ]


def made_datasets(presets: dict[Path, dict[str, Any]]) -> list[Dataset]:
    """Make a dataset in each folder; what a preset does not say has the paper's value."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pool.submit(_make, presets).result()
    return [open_dataset(root) for root in presets]


def _make(presets: dict[Path, dict[str, Any]]) -> None:
    from scenegen.making.blender import BlenderMaker
    from scenegen.making.generation import generate

    maker = BlenderMaker()
    for root, data in presets.items():
        generate(root, preset_from_dict(data, "benchmark"), maker, lambda: None)


def _first_of(dataset: Dataset, object_class: str) -> str:
    return next(id_ for id_ in dataset.ids() if dataset.scene(id_).object_class == object_class)
