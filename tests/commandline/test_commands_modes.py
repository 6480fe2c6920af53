"""Every file and folder that a command writes has the permissions that the umask leaves."""

import os
import stat

import pytest
from night_commands import night_here
from training_runs import settings

from model.training.loop import train


def wrong_modes(folder, umask):
    """(path, permissions) of what has others than the umask leaves."""
    return [
        (str(entry), oct(stat.S_IMODE(entry.stat().st_mode)))
        for entry in (folder, *folder.rglob("*"))
        if stat.S_IMODE(entry.stat().st_mode) != (0o777 if entry.is_dir() else 0o666) & ~umask
    ]


def test_files_of_the_whole_pipeline_have_the_permissions_of_the_umask(pipeline):
    umask = os.umask(0)
    os.umask(umask)
    written = [pipeline.folder / name for name in ("data", "run", "report")]
    assert [wrong for folder in written for wrong in wrong_modes(folder, umask)] == []


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_files_of_a_group_can_be_written_by_it(closed_form_scenes, finished_run, exr, tmp_path):
    out, before = tmp_path / "out", os.umask(0o007)
    try:
        out.mkdir()
        train(closed_form_scenes, out / "run", settings(max_epochs=1))
        for command in (
            ("predict", finished_run, exr, "--out", out / "prediction"),
            ("export", finished_run, "--out", out / "model.onnx"),
            (finished_run, closed_form_scenes.root, "--out", out / "report"),
        ):
            done = night_here("night-eval", *command)
            assert done.returncode == 0, done.stderr
    finally:
        os.umask(before)
    assert (out / "run" / "best.safetensors").is_file()
    assert wrong_modes(out, 0o007) == []
