"""Records of renders that a test has changed."""

import dataclasses

from disk import sha256_of
from render.products.verification import verify
from scenegen import FileRecord, RenderRecord, read_record, write_record

NEW = RenderRecord(recipe="{}", attributes={}, files={})


def record_anew(folder, recipe=None):
    """Record the EXR files of a render folder as they are now, as a program would that wrote them wrong."""
    files = {
        file.name: FileRecord(bytes=file.stat().st_size, sha256=sha256_of(file))
        for file in folder.glob("*.exr")
    }
    record = read_record(folder) or NEW
    write_record(folder, dataclasses.replace(record, files=files, recipe=recipe or record.recipe))


def problems(dataset, scene_id="000000"):
    """What verification finds wrong with a scene, as sentences."""
    report = verify(dataset, [scene_id])
    assert (report.checked, report.damaged_scenes) == (1, {})
    return report.problems.get(scene_id, [])
