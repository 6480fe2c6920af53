"""Renders that were damaged afterwards are found, refused by training, and rendered again."""

import re
import shutil

import pytest
from night_commands import night_here, refusal
from render_runs import results

from itof import read_image, write_image


@pytest.mark.long
def test_truncated_flipped_foreign_and_missing_files_are_found_and_repaired(
    rendered_copy, seven_renders, render_here
):
    folder = rendered_copy / "renders"
    truncated = folder / "000000" / "itof.exr"
    truncated.write_bytes(truncated.read_bytes()[:-100])
    flipped = folder / "000001" / "transient.exr"
    content = bytearray(flipped.read_bytes())
    content[len(content) // 2] ^= 1
    flipped.write_bytes(content)
    foreign = folder / "000002" / "mirrored.exr"
    write_image(foreign, read_image(foreign).channels, {"comment": "made by somebody else"})
    (folder / "000003" / "mirrored_transient.exr").unlink()
    (folder / "000004" / "render.json").write_text("{")

    done = night_here("night-render", "verify", rendered_copy)
    assert done.returncode == 1
    bad = dict(re.findall(r"^bad: (\d+): (.*)$", done.stdout, re.MULTILINE))
    assert "itof.exr has" in bad["000000"]
    assert "transient.exr is not what was written" in bad["000001"]
    assert "mirrored.exr has" in bad["000002"]
    assert "mirrored_transient.exr is missing" in bad["000003"]
    assert "render.json is damaged" in bad["000004"]
    assert "7 scenes checked: 2 good, 5 bad" in done.stdout

    assert render_here(rendered_copy).stdout.startswith("5 scenes rendered, 2 were there")
    assert results(rendered_copy) == results(seven_renders)
    clean = night_here("night-render", "verify", rendered_copy)
    assert clean.returncode == 0
    assert "7 scenes checked: 7 good, 0 bad" in clean.stdout


@pytest.mark.long
def test_damage_is_repaired_without_verification_too(rendered_copy, seven_renders, render_here):
    file = rendered_copy / "renders" / "000005" / "itof.exr"
    content = bytearray(file.read_bytes())
    content[-50] ^= 4
    file.write_bytes(content)
    status = night_here("night-render", "status", rendered_copy).stdout
    assert re.search(r"^1 of the missing .* damaged", status, re.MULTILINE)
    assert render_here(rendered_copy).stdout.startswith("1 scene rendered, 6 were there")
    assert results(rendered_copy) == results(seven_renders)


@pytest.mark.long
def test_training_refuses_renders_that_verification_found_bad(rendered_copy, render_here):
    folders = [rendered_copy / "renders" / name for name in ("000000", "000001")]
    shutil.copy(folders[1] / "itof.exr", folders[0] / "itof.exr")
    run = rendered_copy.parent / "run"
    for _ in range(2):  # before and after verification has removed its record
        sentence = refusal("night-train", rendered_copy, "--out", run, "--max-epochs", 1, "--width", 2)
        assert "scene 000000" in sentence
        assert "run night-render" in sentence
        night_here("night-render", "verify", rendered_copy)
    assert render_here(rendered_copy).stdout.startswith("1 scene rendered")
