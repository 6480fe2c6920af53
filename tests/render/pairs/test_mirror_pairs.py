"""Ground truth by a mirror: closed forms, and datasets of measured pairs."""

import json

import numpy as np
import pytest
from measurements import write_npz
from night_commands import night_here, refusal
from synthetic_dataset import closed_form
from training_runs import settings

from itof import DepthMap, phasor_of_return, read_image
from itof.capture.importing import import_capture
from itof.files.measurement_files import Measurement
from itof.wall.wall_view import WallView
from model.data.shards import open_shards
from model.judging.evaluation import evaluate
from model.refinement.judged_refinement import refine_split
from model.training.loop import train
from render.pairs.pairs import Pair, _write_images, region_of, write_pairs
from render.pairs.truth import MirrorError, Region, truth_of_mirror
from scenegen import load_preset, open_dataset, preset_from_dict, sample_scene
from scenegen.pose import wall_geometry

pytestmark = pytest.mark.usefixtures("one_thread")

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 24, 14
OFFSETS_RAD = np.array([0.02, -0.03, 0.01])
PRESET = preset_from_dict(
    {
        "dataset": {"count": 4, "test_fraction": 0.25, "validation_fraction": 0.25},
        "camera": {"width": WIDTH, "height": HEIGHT},
    },
    "test",
)


def returned(radial_depth_m, frequencies_hz=HZ):
    """(H, W, F) phasors of one return at each depth."""
    strength = 0.3 / np.maximum(radial_depth_m, 1) ** 2
    return strength[..., None] * np.stack(
        [phasor_of_return(radial_depth_m, f) for f in frequencies_hz], axis=-1
    )


def corner(index=0, far_m=6.5):
    """Measurement, mirror capture, depth of the object (0 elsewhere), wall and region of a scene.

    In the mirror, everything but the object is a room at the depth `far_m`.
    """
    scene = sample_scene(PRESET, index)
    phasor, depth_m, direct = closed_form(scene, HZ, WIDTH, HEIGHT)
    view = WallView(**wall_geometry(scene.camera, scene.relay_wall))
    wall = view.expected_wall(direct, HZ)
    mirror = returned(np.where(depth_m > 0, depth_m, far_m))
    camera = np.exp(1j * OFFSETS_RAD)
    return phasor * camera, mirror * camera, depth_m, wall, region_of(PRESET, view)


@pytest.mark.parametrize("index", range(4))
def test_the_mirror_shows_the_depth_of_the_object(index):
    phasor, mirror, depth_m, wall, region = corner(index)
    found = truth_of_mirror(mirror, phasor, wall, region, HZ)
    np.testing.assert_array_equal(found.depth_map.mask, depth_m > 0)
    # The hidden light, up to 3 mrad of each phase, moves the offsets: 1 mrad at 60 MHz is 0.4 mm.
    np.testing.assert_allclose(found.depth_map.radial_depth_m, depth_m, atol=1.2e-3)
    np.testing.assert_allclose(found.offsets_rad, OFFSETS_RAD, atol=3e-3)
    # Mirrored back, the points are where the object is: 30 cm at most from the middle of its disc.
    centre = np.array(sample_scene(PRESET, index).hidden_objects[0].location_m)
    scene = sample_scene(PRESET, index)
    view = WallView(**wall_geometry(scene.camera, scene.relay_wall))
    there = found.object_points_m @ np.asarray(view.camera_axes) + np.asarray(view.camera_location_m)
    assert np.linalg.norm(there - centre, axis=1).max() < 0.3 + 1.2e-3


def test_only_single_returns_behind_the_wall_and_in_the_region_are_the_object():
    phasor, mirror, depth_m, wall, region = corner()
    shown = depth_m > 0
    near = np.argwhere(~shown)[:40]
    mirror = mirror.copy()
    mirror[tuple(near[:10].T)] = returned(np.asarray(wall.radial_depth_m))[tuple(near[:10].T)]  # the wall
    mirror[tuple(near[10:20].T)] = 0  # no light
    mirror[tuple(near[20:23].T)] = returned(np.full((HEIGHT, WIDTH), depth_m.max()))[tuple(near[20:23].T)]
    two = np.argwhere(shown)[:3]
    rng = np.random.default_rng(0)
    mirror[tuple(two.T)] = 0.02 * np.exp(2j * np.pi * rng.random((3, 3)))  # phases of no single return
    found = truth_of_mirror(mirror, phasor, wall, region, HZ).depth_map.mask
    assert not found[tuple(near.T)].any()
    assert not found[tuple(two.T)].all()
    rest = shown.copy()
    rest[tuple(two.T)] = False
    assert found[rest].all()


@pytest.mark.parametrize(
    "frequencies_hz", [HZ, (20.1e6, 50.3e6, 60.7e6), (20.001e6, 50.003e6, 60.007e6), (60.1e6, 100.3e6)]
)
def test_noise_makes_no_holes_whatever_the_common_divisor_of_the_frequencies(frequencies_hz):
    scene = sample_scene(PRESET, 0)
    phasor, depth_m, direct = closed_form(scene, frequencies_hz, WIDTH, HEIGHT)
    view = WallView(**wall_geometry(scene.camera, scene.relay_wall))
    wall = view.expected_wall(direct, frequencies_hz)
    rng = np.random.default_rng(1)
    mirror = returned(np.where(depth_m > 0, depth_m, 6.5), frequencies_hz)
    mirror = mirror * np.exp(0.1j * rng.standard_normal(mirror.shape))
    found = truth_of_mirror(mirror, phasor, wall, region_of(PRESET, view), frequencies_hz)
    np.testing.assert_array_equal(found.depth_map.mask, depth_m > 0)
    # Noise of 0.1 rad at all frequencies: 2.4 cm at 60 MHz alone; five times that is a wrong turn.
    np.testing.assert_allclose(found.depth_map.radial_depth_m, depth_m, atol=0.12)


@pytest.mark.parametrize("frequencies_hz", [HZ, (20.1e6, 50.3e6, 60.7e6), (16e6, 80e6, 120e6)])
@pytest.mark.parametrize("noise_rad", [0.0, 0.05])
def test_a_room_behind_the_object_is_not_taken_for_it(frequencies_hz, noise_rad):
    scene = sample_scene(PRESET, 0)
    phasor, depth_m, direct = closed_form(scene, frequencies_hz, WIDTH, HEIGHT)
    view = WallView(**wall_geometry(scene.camera, scene.relay_wall))
    wall = view.expected_wall(direct, frequencies_hz)
    room_m = np.linspace(5.5, 14, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    mirror = returned(np.where(depth_m > 0, depth_m, room_m), frequencies_hz)
    mirror = mirror * np.exp(1j * noise_rad * np.random.default_rng(2).standard_normal(mirror.shape))
    found = truth_of_mirror(mirror, phasor, wall, region_of(PRESET, view), frequencies_hz).depth_map
    np.testing.assert_array_equal(found.mask, depth_m > 0)


def test_mirrors_that_show_nothing_or_another_wall_are_refused():
    phasor, mirror, _, wall, region = corner()
    with pytest.raises(MirrorError, match="shows no object"):
        truth_of_mirror(returned(np.full((HEIGHT, WIDTH), 6.5)), phasor, wall, region, HZ)
    with pytest.raises(MirrorError, match="shows no object"):
        truth_of_mirror(mirror, phasor, wall, Region(region.centre_m, 0.01), HZ)
    with pytest.raises(MirrorError, match="of one camera"):
        truth_of_mirror(mirror[1:], phasor, wall, region, HZ)
    with pytest.raises(MirrorError, match="the phases of the wall scatter by"):
        truth_of_mirror(mirror, mirror, wall, region, HZ)
    with pytest.raises(MirrorError, match="holds no light"):
        truth_of_mirror(mirror, 0 * phasor, wall, region, HZ)


def test_the_region_holds_every_object_of_the_preset():
    view = WallView(**wall_geometry(sample_scene(PRESET, 0).camera, sample_scene(PRESET, 0).relay_wall))
    region = region_of(PRESET, view)
    for index in range(60):
        for part in sample_scene(PRESET, index).hidden_objects:
            there = np.asarray(view.camera_axes) @ (np.array(part.location_m) - view.camera_location_m)
            reach = np.linalg.norm(there - region.centre_m) + np.linalg.norm(part.size_m) / 2
            assert reach < region.radius_m
    twice = region.mirrored(np.array([0.1, 0.2, 0.4])).mirrored(np.array([0.1, 0.2, 0.4]))
    np.testing.assert_allclose(twice.centre_m, region.centre_m, atol=1e-12)


@pytest.fixture(scope="module")
def pair_folders(tmp_path_factory):
    """Four folders of a measurement with its capture of the corner, and of a mirror; for reading only."""
    root, folders = tmp_path_factory.mktemp("captures"), []
    rng = np.random.default_rng(3)
    pixels = np.exp(0.05j * rng.standard_normal((HEIGHT, WIDTH, 3)))  # errors of single pixels, large ones
    for index in range(4):
        phasor, mirror, _, wall, _ = corner(index)
        folder = root / f"pair {index}"
        folder.mkdir()
        corner_alone = wall.direct * np.exp(1j * OFFSETS_RAD) * pixels * 300
        np.savez(
            folder / "measurement.npz",
            phasors=(phasor * pixels * 200).astype(np.complex64),
            reference=corner_alone.astype(np.complex64),
            frequencies_hz=HZ,
        )
        np.savez(folder / "mirror.npz", phasors=mirror.astype(np.complex64), frequencies_hz=HZ)
        folders.append(folder)
    return folders


@pytest.fixture(scope="module")
def pairs(pair_folders, tmp_path_factory):
    return write_pairs(pair_folders, PRESET, tmp_path_factory.mktemp("pairs") / "data").dataset


def test_a_dataset_of_pairs_holds_measurements_without_the_errors_of_the_camera(pairs):
    shards = open_shards(pairs, progress=False)
    for index, scene in enumerate(pairs.ids()):
        phasor, depth_m, direct = closed_form(sample_scene(PRESET, index), HZ, WIDTH, HEIGHT)
        found = shards.read([index]).phasors[0]
        ratio = found / direct / (phasor / direct)
        # Complex64 in and out; the fit that takes the errors of the camera out has no closed form.
        np.testing.assert_allclose(ratio / np.abs(ratio).mean(), 1, atol=2e-5)
        assert np.abs(found[..., 0]).mean() == pytest.approx(np.abs(direct[..., 0]).mean(), rel=1e-5)
        truth = DepthMap.read(pairs.render_folder(scene) / "mirrored.exr")
        # The mean of 50 mrad of 336 pixels: 2.7 mrad at each frequency, at most four times that.
        np.testing.assert_allclose(truth.radial_depth_m, depth_m, atol=4e-3)
    assert [len(pairs.ids(split)) for split in ("train", "validation", "test")] == [2, 1, 1]
    assert pairs.is_measured
    assert open_dataset(pairs.root).scene(pairs.ids()[0]).object_class == "measured"


def test_pixels_that_see_no_wall_are_dark_and_not_nan(tmp_path):
    phasor, mirror, _, wall, region = corner()
    truth = truth_of_mirror(mirror, phasor, wall, region, HZ)
    direct = np.array(wall.direct)
    direct[:, :2] = 0  # as of rays that miss the wall
    reference = np.array(wall.direct)
    reference[3, 5] = 0  # a dead pixel
    measurement = Measurement(tmp_path / "m.npz", phasor[None], HZ, reference, in_training_unit=False)
    _write_images(tmp_path / "render", Pair(measurement, truth), direct, HZ)
    found = read_image(tmp_path / "render" / "itof.exr").phasors()[0]
    assert np.isfinite(found).all()
    dark = np.zeros((HEIGHT, WIDTH), bool)
    dark[:, :2] = dark[3, 5] = True
    np.testing.assert_array_equal((found == 0).all(axis=-1), dark)


@pytest.mark.long
def test_networks_are_trained_and_judged_on_pairs(pairs, tmp_path):
    chosen = {"channels": "residual", "reference": "self", "flip_columns": False, "rotation_deg": 0.0}
    train(pairs, tmp_path / "run", settings(**chosen, translation=0.0, max_epochs=1))
    report = evaluate(tmp_path / "run", pairs, tmp_path / "report", device="cpu", progress=False)
    assert len(report.scenes) == 1
    assert report.scenes[0].object_class == "measured"


@pytest.mark.long
def test_pairs_are_refined_only_if_a_preset_says_what_may_be_there(pairs, tmp_path):
    chosen = {"channels": "residual", "reference": "self", "flip_columns": False, "rotation_deg": 0.0}
    train(pairs, tmp_path / "run", settings(**chosen, translation=0.0, max_epochs=1))
    command = ("night-eval", "refine", tmp_path / "run", pairs.root, "--out", tmp_path / "out")
    assert refusal(*command) == (
        f"{pairs.root} holds measurements and does not say what may be there: give a preset with the "
        "shapes and sizes, --objects PRESET"
    )
    assert not (tmp_path / "out").exists()
    objects = tmp_path / "objects.toml"
    objects.write_text('[hidden_object]\nshapes = ["cube", "cone"]\nsize_m = { cube = [0.4, 0.4, 0.4] }\n')
    report = refine_split(
        *(tmp_path / "run", pairs, tmp_path / "out"),
        objects=load_preset(objects),
        device="cpu",
        progress=False,
    )
    recipe = json.loads((tmp_path / "out" / "recipe.json").read_text())
    assert recipe["sizes_m"] == {"cube": [0.4, 0.4, 0.4], "cone": [0.56, 0.56, 0.55]}
    assert [scene.object_class for scene in report.scenes] == ["measured"]


def test_captures_are_not_rendered_over(pairs):
    before = {file: file.read_bytes() for file in pairs.root.rglob("*") if file.is_file()}
    for command in (("night-render", pairs.root), ("night-render", pairs.root, "--dry-run")):
        assert "holds captures of a camera: there is nothing to render" in refusal(*command)
    assert {file: file.read_bytes() for file in pairs.root.rglob("*") if file.is_file()} == before


def test_the_command_makes_the_dataset(pair_folders, tmp_path):
    preset = tmp_path / "corner.toml"
    preset.write_text("[dataset]\ntest_fraction = 0.5\nvalidation_fraction = 0.25\n")
    done = night_here(
        *(
            "night-eval",
            "capture",
            "pairs",
            *pair_folders,
            "--preset",
            preset,
            "--out",
            tmp_path / "data",
            "--json",
        )
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["scenes"] == 4
    assert len(open_dataset(tmp_path / "data").ids("test")) == 2


def test_folders_that_are_no_pairs_are_refused_in_a_sentence(pair_folders, tmp_path):
    basis = ("night-eval", "capture", "pairs")
    rest = ("--preset", "paper", "--out", tmp_path / "data")
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "must hold one measurement.npz (or .h5)" in refusal(*basis, empty, *rest)
    small = tmp_path / "small"
    small.mkdir()
    for name in ("measurement", "mirror"):
        values = np.load(pair_folders[0] / f"{name}.npz")
        np.savez(small / f"{name}.npz", phasors=values["phasors"][:, 2:-2], frequencies_hz=HZ)
    assert "import all of them at one size" in refusal(*basis, pair_folders[0], small, *rest)
    assert "is named twice" in refusal(*basis, small, small, *rest)
    assert "describe one corner" in refusal(*basis, small, "--preset", "any-corner", *rest[2:])
    values = dict(np.load(small / "measurement.npz"))
    np.savez(small / "measurement.npz", **{**values, "phasors": 0 * values["phasors"]})
    assert "the measurement holds no light" in refusal(*basis, small, *rest)
    dark = np.array([0, 1, 1])
    known = values["phasors"]
    np.savez(small / "measurement.npz", **{**values, "phasors": dark * known, "reference": known})
    assert "the measurement holds no light at 20 MHz" in refusal(*basis, small, *rest)
    wide = tmp_path / "wide.toml"
    wide.write_text("[camera]\nhorizontal_fov_deg = 70.0\n")
    sidecar = tmp_path / "camera.toml"
    sidecar.write_text(
        'layout = "phasors"\narrays = ["phasors"]\naxes = ["row", "column", "frequency"]\n'
        f"frequencies_hz = {list(HZ)}\nhorizontal_fov_deg = 60.0\n"
    )
    imported = tmp_path / "imported"
    imported.mkdir()
    for name in ("measurement", "mirror"):
        z = np.load(pair_folders[0] / f"{name}.npz")["phasors"]
        z = z * (1 + 1e-4 * np.random.default_rng(0).standard_normal(z.shape))  # no two rows are the same
        frames = write_npz(tmp_path / f"{name}.npz", phasors=z)
        import_capture(frames, sidecar, imported / f"{name}.npz")
    said = refusal(*basis, imported, "--preset", wide, *rest[2:])
    assert "is 60.00 degrees wide and the camera of the preset 70" in said
    np.savez(small / "measurement.npz", **values, horizontal_fov_deg=61.0)
    assert "is 61.00 degrees wide and the camera of the preset 60" in refusal(*basis, small, *rest)
    np.savez(small / "measurement.npz", **values)
    (small / "mirror.npz").write_bytes(b"PK")
    assert "mirror.npz cannot be read" in refusal(*basis, small, *rest)
    there = tmp_path / "there"
    there.mkdir()
    assert "exists already" in refusal(*basis, pair_folders[0], *rest[:3], there)
    assert not (tmp_path / "data").exists()
