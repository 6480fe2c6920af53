"""`night-gen preview` from the command line."""

import signal
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from matplotlib import image as png
from night_commands import night_here, refusal
from previews import orange
from render_records import record_anew
from scene_folders import contents

from itof import write_image
from render.products.preview import meshes_in
from render.settings import RenderError
from scenegen import open_dataset
from scenegen.making.meshes import with_meshes


@pytest.fixture
def small_pictures(monkeypatch):
    """Pictures of a quarter of the pixels, which Blender renders faster."""
    for module in ("preview", "contact_sheet"):
        monkeypatch.setattr(f"render.products.{module}.PICTURE_SIZE", (144, 108))


@pytest.mark.long
@pytest.mark.usefixtures("small_pictures")
def test_the_command_leaves_scenes_renders_and_night_gen_alone(corners):
    before = contents(corners.root)
    (corners.root / "README.md").write_text("mine")
    done = night_here("night-gen", "preview", corners.root, "--only", "000002")
    assert done.returncode == 0, done.stderr
    pictures = [corners.root / "preview" / name for name in ("contact_sheet.png", "distributions.png")]
    assert done.stdout.splitlines() == [str(file) for file in pictures]
    assert "README.md is not ours and was left alone" in done.stderr
    (corners.root / "README.md").unlink()
    done = night_here("night-gen", "preview", corners.root, "--count", 1, "--licence", "CC0")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == str(corners.root / "README.md")
    for file in pictures:
        sheet = png.imread(file)
        assert sheet[..., :3].std() > 0.05  # not blank
    orange_ones = orange(np.round(255 * png.imread(pictures[0])).astype(int))
    assert len(orange_ones) > 30  # Blender's view is in the sheet
    (corners.root / "preset.toml").write_text(
        "[dataset]\ncount = 9\nseed = 3\n[camera]\nwidth = 24\nheight = 18\n[transient]\nbin_count = 1400\n"
    )
    again = night_here("night-gen", "scenes", corners.root, "--preset", corners.root / "preset.toml")
    assert again.returncode == 0, again.stderr
    (corners.root / "preset.toml").unlink()
    after = contents(corners.root)
    added = {"README.md", "croissant.json", "preview/contact_sheet.png", "preview/distributions.png"}
    assert {name: data for name, data in after.items() if name not in added} == before


INTERRUPTED_IN_A_PICTURE = """
import contextlib, signal, sys
import numpy, cli
from scenegen.making.blender import BlenderMaker

def picture(_, __, width, height):
    with contextlib.suppress(KeyboardInterrupt):  # as Cycles does, which calls Python while it renders
        signal.raise_signal(signal.SIGINT)
    return numpy.zeros((height, width, 3), numpy.uint8)

signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
signal.signal(signal.SIGINT, signal.default_int_handler)
BlenderMaker.picture = picture
cli.night_gen(["preview", sys.argv[1], "--count", "2"])
"""


def test_ctrl_c_while_blender_renders_ends_the_command(corners):
    program = [sys.executable, "-c", INTERRUPTED_IN_A_PICTURE, str(corners.root)]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGINT
    assert done.stderr.endswith("interrupted\n")
    assert not (corners.root / "preview").exists()


def test_what_cannot_be_previewed_is_refused(corners, tmp_path):
    assert "no folder" in refusal("night-gen", "preview", tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "NIGHT dataset" in refusal("night-gen", "preview", tmp_path / "empty")
    assert "no scene 000099" in refusal("night-gen", "preview", corners.root, "--only", "000099")
    assert "name of a licence" in refusal("night-gen", "preview", corners.root, "--licence", "")
    file = corners.render_folder("000001") / "mirrored.exr"
    whole = file.read_bytes()
    file.write_bytes(whole[:-300])
    assert "mirrored.exr is not the file that night-render wrote" in refusal(
        "night-gen", "preview", corners.root
    )
    record_anew(file.parent)
    assert "damaged or no EXR" in refusal("night-gen", "preview", corners.root)
    write_image(file, {"R": np.ones((18, 24))}, {})
    record_anew(file.parent)
    assert "000001/mirrored.exr" in refusal("night-gen", "preview", corners.root)
    file.write_bytes(whole)
    write_image(corners.render_folder("000001") / "itof.exr", {"itof.20MHz.Re": np.ones((18, 24))}, {})
    record_anew(file.parent)
    assert "scene 000001: itof.exr" in refusal("night-gen", "preview", corners.root)
    nan = np.full((18, 24), np.nan)
    write_image(
        corners.render_folder("000001") / "itof.exr", {"itof.20MHz.Re": nan, "itof.20MHz.Im": nan}, {}
    )
    record_anew(file.parent)
    assert "NaN" in refusal("night-gen", "preview", corners.root)
    assert not (corners.root / "preview").exists()
    assert not (corners.root / "README.md").exists()


# Meshes of the user's own


@pytest.mark.long
@pytest.mark.usefixtures("small_pictures")
def test_a_users_mesh_is_drawn_from_the_scenes_own_files(tmp_path):
    source = trimesh.creation.annulus(r_min=0.2, r_max=0.6, height=1.0, sections=24)
    source.export(tmp_path / "ring.ply")
    (tmp_path / "ring.toml").write_text(
        '[dataset]\ncount = 1\n[hidden_object]\nshapes = ["mesh:ring.ply"]\ncomposite_fraction = 0.0\n'
        "[camera]\nwidth = 24\nheight = 18\n"
    )
    done = night_here("night-gen", "scenes", tmp_path / "rings", "--preset", tmp_path / "ring.toml")
    assert done.returncode == 0, done.stderr
    dataset = open_dataset(tmp_path / "rings")
    original = with_meshes(dataset.preset, tmp_path)[1]["mesh:ring.ply"]
    (tmp_path / "ring.ply").unlink()
    found = meshes_in(dataset, dataset.ids())["mesh:ring.ply"]
    assert found.sha256 == original.sha256
    # Places came through float32 in a room of metres: 1e-7 m, in units of a 0.5 m box.
    np.testing.assert_allclose(found.vertices, original.vertices, atol=2e-6)
    assert sorted(map(sorted, found.triangles.tolist())) == sorted(map(sorted, original.triangles.tolist()))
    done = night_here("night-gen", "preview", tmp_path / "rings")
    assert done.returncode == 0, done.stderr
    sheet = np.round(255 * png.imread(tmp_path / "rings" / "preview" / "contact_sheet.png")).astype(int)
    assert len(orange(sheet)) > 100
    (dataset.scene_folder("000000") / "hidden_object_0.ply").unlink()
    with pytest.raises(RenderError, match="run night-gen scenes again"):
        meshes_in(dataset, dataset.ids())
