"""What a scene's render folder holds of an earlier render, before a new one is written."""

from __future__ import annotations

from pathlib import Path

from disk import sha256_of
from scenegen import IMAGE_FILES, RECORD_FILE, TRANSIENT_FILES, RenderRecord, read_record
from scenegen.render_folder import difference


def forget_earlier(folder: Path, recipe: str) -> None:
    """Delete the earlier record, and all transients except intact ones recorded for `recipe`."""
    record = read_record(folder)
    kept = record.files if record is not None and record.recipe == recipe else {}
    (folder / RECORD_FILE).unlink(missing_ok=True)
    for name in TRANSIENT_FILES:
        file = folder / name
        if file.is_file() and (name not in kept or sha256_of(file) != kept[name].sha256):
            file.unlink()


def is_damaged(folder: Path, record: RenderRecord) -> bool:
    """Whether an image of a render is not as its record says."""
    images = {name: record.files[name] for name in IMAGE_FILES if name in record.files}
    return any(difference(folder / name, expected) for name, expected in images.items())
