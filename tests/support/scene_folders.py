"""Small presets, and what a dataset folder holds, for the tests that make scenes."""

from scenegen import preset_from_dict


def of_seed_5(count, **tables):
    """A preset of so many scenes of seed 5; tables that are not given have the paper's values."""
    return preset_from_dict({"dataset": {"count": count, "seed": 5}, **tables}, "seed 5")


def contents(root):
    """Bytes of every file under a folder, by path."""
    return {str(f.relative_to(root)): f.read_bytes() for f in sorted(root.rglob("*")) if f.is_file()}


def identities(root):
    """Inode and time of change of every file and folder: they change when it is written again."""
    stats = {str(entry.relative_to(root)): entry.stat() for entry in sorted(root.rglob("*"))}
    return {name: (stat.st_ino, stat.st_mtime_ns) for name, stat in stats.items()}
