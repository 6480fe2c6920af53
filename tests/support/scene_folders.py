"""Small presets and scenes, and what a dataset folder holds, for the tests that make scenes."""

import dataclasses

from scenegen import preset_from_dict, sample_scene


def of_seed_5(count, **tables):
    """A preset of so many scenes of seed 5; tables that are not given have the paper's values."""
    return preset_from_dict({"dataset": {"count": count, "seed": 5}, **tables}, "seed 5")


def upright_cube():
    """A scene of the paper with a cube in the middle of its range, not turned."""
    scene = sample_scene(preset_from_dict({}, "paper"), 0)
    assert scene.object_class == "cube"
    return with_object(scene, location_m=(1.15, 0.9, 1.6), rotation_deg=(0.0, 0.0, 0.0))


def with_object(scene, **changes):
    """The scene with only its first hidden object, changed."""
    return dataclasses.replace(
        scene, hidden_objects=(dataclasses.replace(scene.hidden_objects[0], **changes),)
    )


def contents(root):
    """Bytes of every file under a folder, by path."""
    return {str(f.relative_to(root)): f.read_bytes() for f in sorted(root.rglob("*")) if f.is_file()}


def identities(root):
    """Inode and time of change of every file and folder: they change when it is written again."""
    stats = {str(entry.relative_to(root)): entry.stat() for entry in sorted(root.rglob("*"))}
    return {name: (stat.st_ino, stat.st_mtime_ns) for name, stat in stats.items()}
