"""Datasets with a mesh of the user, a ring, made by the command."""

import trimesh
from captures import toml
from night_commands import night_here

from scenegen import open_dataset

RING = "mesh:ring.ply"


def scenes_with_rings(folder, tables):
    """A dataset of a preset, whose shapes may name `RING`.

    By the command and not in processes: a test process has loaded Blender, and new ones inherit its paths.
    """
    trimesh.creation.torus(major_radius=0.3, minor_radius=0.12).export(folder / "ring.ply")
    lines = [
        f"[{name}]\n" + "".join(f"{key} = {toml(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    ]
    (folder / "rings.toml").write_text("".join(lines))
    done = night_here("night-gen", "scenes", folder / "data", "--preset", folder / "rings.toml")
    assert done.returncode == 0, done.stderr
    return open_dataset(folder / "data")
