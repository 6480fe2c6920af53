"""The relay wall where captures of the empty corner show it."""

from dataclasses import replace

import numpy as np
import pytest
from night_commands import night_here
from synthetic_dataset import closed_form

from disk import sha256_of
from itof import DepthMap, phasor_of_return, residual_channels
from itof.capture.facts import CaptureFacts
from itof.capture.record import ImportRecord, record_path, write_import_record
from itof.capture.sidecar import Sidecar
from itof.wall.empty_corner import captured_wall, find_wall
from itof.wall.expected_wall import angle_deg, distance_m
from itof.wall.self_calibration import calibrate
from itof.wall.wall_view import WallView
from model.data.corner import wall_view
from model.data.shards import open_shards
from render.pairs.pairs import write_pairs
from render.pairs.relay_wall import relay_wall_at
from scenegen import preset_from_dict, sample_scene
from scenegen.pose import wall_geometry

pytestmark = pytest.mark.usefixtures("one_thread")

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 40, 30
OFFSETS_RAD = np.array([0.01, -0.015, 0.005])
KNOWN_RAD = 0.01
SPLIT = {"dataset": {"test_fraction": 1.0, "validation_fraction": 0.0}}
PRESET = preset_from_dict({**SPLIT, "camera": {"width": WIDTH, "height": HEIGHT}}, "test")
SCENE = sample_scene(PRESET, 0)
VIEW = WallView(**wall_geometry(SCENE.camera, SCENE.relay_wall))
WALL = VIEW.expected_wall(VIEW.direct_phasors(WIDTH, HEIGHT, HZ), HZ)
# As far from the preset's as a tape measure leaves it.
ELSEWHERE = replace(SCENE.relay_wall, location_m=(0.02, 0.0, 2.0), rotation_deg=(1.0, 89.5, -1.4))
TRUE_VIEW = WallView(**wall_geometry(SCENE.camera, ELSEWHERE))
TRUE = TRUE_VIEW.expected_wall(TRUE_VIEW.direct_phasors(WIDTH, HEIGHT, HZ), HZ)


def camera(phasor, pixels_rad=0.0, seed=0):
    """The phases of a camera with offsets, the four cycles of square waves, and errors of single pixels."""
    error = OFFSETS_RAD + 0.06 * np.sin(4 * np.angle(TRUE.direct) + 1)
    error = error + pixels_rad * np.random.default_rng(seed).standard_normal(error.shape)
    return phasor * np.exp(1j * error)


def apart_m(plane_per_m):
    """(H, W) distance from the true wall along the rays."""
    return 1 / (WALL.rays @ plane_per_m) - np.asarray(TRUE.radial_depth_m)


def test_the_wall_is_found_behind_offsets_and_four_cycles():
    assert np.abs(apart_m(WALL.plane_per_m)).max() > 0.05
    found = find_wall([camera(TRUE.direct)], WALL)
    assert found.is_certain
    assert not replace(found, needs_distance=True).is_certain  # offsets of 0.1 rad are 3 cm
    assert found.sentence.startswith("the empty corner shows the wall ")
    # The angle is what predictions need: without four cycles it would be exact.
    assert angle_deg(found.plane_per_m, TRUE.plane_per_m) < 2 * found.tilt_std_deg
    assert abs(distance_m(found.plane_per_m) - distance_m(TRUE.plane_per_m)) < 2 * found.distance_std_m
    found = find_wall([camera(TRUE.direct)], WALL, KNOWN_RAD, needs_distance=True)
    assert found.is_certain
    assert np.abs(apart_m(found.plane_per_m)).max() < 2 * found.distance_std_m


@pytest.mark.parametrize("shape", ["across", "down", "radial"])
@pytest.mark.parametrize("grows", [0.0, 1.0])
def test_smooth_errors_of_10_mrad_are_within_what_is_told(shape, grows):
    """Errors that are the same at all frequencies, or grow with them as a delay does."""
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    error = {"across": x, "down": y, "radial": x**2 + y**2}[shape] / 2  # 1 from end to end
    scale = (np.array(HZ) / 60e6) ** grows
    found = find_wall([TRUE.direct * np.exp(10e-3j * error[..., None] * scale)], WALL)
    off_m = np.sqrt((apart_m(found.plane_per_m) ** 2).mean())
    # No less certain than from 50 MHz alone, where the unknown offset, 0.1 rad, is 5 cm.
    assert 1e-3 < off_m < 2 * found.distance_std_m < 2 * 0.1 / WALL.slope[1]
    assert 0.01 < angle_deg(found.plane_per_m, TRUE.plane_per_m) < 2 * found.tilt_std_deg < 3


def test_corners_of_a_camera_that_was_moved_do_not_say_where_the_wall_is():
    view = WallView(**wall_geometry(SCENE.camera, replace(ELSEWHERE, location_m=(0.08, 0.0, 2.0))))
    moved, still = (
        find_wall(
            [TRUE.direct, other.direct_phasors(WIDTH, HEIGHT, HZ)], WALL, KNOWN_RAD, needs_distance=True
        )
        for other in (view, TRUE_VIEW)
    )
    assert not moved.is_certain
    assert still.is_certain


def test_the_channels_of_a_capture_are_those_of_the_wall_where_it_is():
    phasor, _, direct = closed_form(replace(SCENE, relay_wall=ELSEWHERE), HZ, WIDTH, HEIGHT)

    def channels(wall):
        seen = camera(phasor)
        return residual_channels(seen, calibrate(seen, wall).moved(seen, wall), "uniform")

    true = residual_channels(phasor, calibrate(phasor, TRUE).moved(phasor, TRUE), "uniform")
    there, elsewhere = (
        np.abs(channels(wall) - true).max()
        for wall in (captured_wall(camera(direct), WALL), WALL.captured(camera(direct)))
    )
    assert there < 2**-19  # float32 rounds numbers near 1 by 2^-24, in some ten operations
    assert elsewhere > 5 * there


def test_noise_of_a_capture_where_it_shows_no_wall_is_no_return():
    """A black middle wall at the right; the relay wall gets darker towards it, to a fifth."""
    brightness, dark = np.linspace(1, 0.2, WIDTH)[:, None], np.zeros((HEIGHT, WIDTH), bool)
    dark[:, -4:] = True
    noise = (
        3e-4 * np.abs(TRUE.direct).mean() * np.exp(2j * np.pi * np.random.default_rng(0).random(dark.shape))
    )
    capture = np.where(dark[..., None], noise[..., None], camera(TRUE.direct) * brightness)
    found = captured_wall(capture, WALL)
    np.testing.assert_array_equal((found.direct == 0).all(axis=-1), dark)
    np.testing.assert_array_equal(found.direct[~dark], capture[~dark])
    assert angle_deg(found.plane_per_m, TRUE.plane_per_m) < 0.5


def test_a_dark_corner_leaves_the_wall_where_it_is_expected():
    dark = np.zeros((HEIGHT, WIDTH, 3), complex)
    np.testing.assert_array_equal(captured_wall(dark, WALL).plane_per_m, WALL.plane_per_m)
    assert find_wall([dark], WALL).sentence.startswith("the empty corner shows no wall, ")


def test_the_wall_of_a_scene_is_moved_there():
    found = find_wall([TRUE.direct], WALL)
    moved = relay_wall_at(found.plane_per_m, SCENE.relay_wall, VIEW)
    plane = WallView(**wall_geometry(SCENE.camera, moved)).expected_wall(WALL.direct, HZ).plane_per_m
    np.testing.assert_allclose(plane, found.plane_per_m, atol=1e-9)
    # What pixels that see an area leave: the second moments of their paths (itof.weighted_reference).
    np.testing.assert_allclose(plane, TRUE.plane_per_m, atol=3e-4)
    assert replace(moved, location_m=ELSEWHERE.location_m, rotation_deg=ELSEWHERE.rotation_deg) == ELSEWHERE
    # It keeps its place along itself: it moves by about the 2 cm between the planes.
    assert np.linalg.norm(np.subtract(moved.location_m, SCENE.relay_wall.location_m)) < 0.02 + 1e-3


def record_beside(file, fov_deg):
    """The record of an import by a sidecar that knows the phase offsets."""
    known = {"frequencies_hz": HZ, "phase_offsets_std_rad": (KNOWN_RAD,) * 3}
    sidecar = Sidecar("phasors", ("z",), ("row", "column", "frequency"), horizontal_fov_deg=fov_deg, **known)
    facts = CaptureFacts(1, (WIDTH, HEIGHT), (WIDTH, HEIGHT), fov_deg, None, (0.0,) * 3, 0.0, 0.0, 0.0)
    record = ImportRecord(1, sha256_of(file), {}, {}, sidecar, facts, None, "a test")
    write_import_record(record_path(file), record)


@pytest.fixture
def pair(tmp_path):
    """Writes a pair of the corner with the wall elsewhere."""
    scene = replace(SCENE, relay_wall=ELSEWHERE)
    phasor, depth_m, direct = closed_form(scene, HZ, WIDTH, HEIGHT)
    seen_m = np.where(depth_m > 0, depth_m, 6.5)
    mirror = np.stack([0.3 / seen_m**2 * phasor_of_return(seen_m, f) for f in HZ], axis=-1)

    def write(pixels_rad):
        folder = tmp_path / f"pair {pixels_rad}"
        folder.mkdir()
        arrays = {"phasors": camera(phasor, pixels_rad), "reference": camera(direct, pixels_rad)}
        arrays = {name: z.astype(np.complex64) for name, z in arrays.items()}
        np.savez(folder / "measurement.npz", **arrays, frequencies_hz=HZ)
        record_beside(folder / "measurement.npz", PRESET.camera.horizontal_fov_deg)
        offsets = np.exp(1j * OFFSETS_RAD)  # and no four cycles, which would be an error of the truth
        np.savez(folder / "mirror.npz", phasors=(mirror * offsets).astype(np.complex64), frequencies_hz=HZ)
        return folder

    return write, phasor, direct, depth_m


def test_pairs_have_the_wall_of_their_empty_corners(pair, tmp_path):
    write, phasor, direct, depth_m = pair
    folder, off_m, made = write(0.0), {}, {}
    for place in ("empty", "preset"):
        made[place] = write_pairs([folder], PRESET, tmp_path / place, wall=place).dataset
        truth = DepthMap.read(made[place].render_folder("000000") / "mirrored.exr")
        np.testing.assert_array_equal(truth.mask, depth_m > 0)
        off_m[place] = np.abs(truth.radial_depth_m - depth_m).max()
    # The mean of the four cycles over the wall, 11 mrad at 60 and 46 at 20 MHz, is taken for an offset.
    assert off_m["empty"] < 0.015 < 0.02 < off_m["preset"]
    found = open_shards(made["empty"], progress=False).read([0]).phasors[0]
    error = np.angle(found / phasor)
    assert np.abs(error - error.mean(axis=(0, 1))).max() < 0.02  # 8 mm at 60 MHz
    plane = wall_view(made["empty"]).expected_wall(direct, HZ).plane_per_m
    assert np.abs(apart_m(plane)).max() < 0.01


def test_each_scene_keeps_the_material_of_its_wall(pair, tmp_path):
    made = write_pairs([pair[0](0.0), pair[0](1e-3)], PRESET, tmp_path / "data")
    assert made.wall.is_certain
    walls = [made.dataset.scene(scene).relay_wall for scene in made.dataset.ids()]
    assert [wall.roughness for wall in walls] == [
        sample_scene(PRESET, place).relay_wall.roughness for place in (0, 1)
    ]
    assert walls[0].roughness != walls[1].roughness
    assert walls[0].location_m == walls[1].location_m != SCENE.relay_wall.location_m


def test_a_wall_whose_distance_is_uncertain_is_where_the_preset_has_it(pair, tmp_path):
    folder = pair[0](0.0)
    record_path(folder / "measurement.npz").unlink()  # so that nothing is known of its phase offsets
    preset = tmp_path / "corner.toml"
    preset.write_text("[dataset]\ntest_fraction = 1.0\nvalidation_fraction = 0.0\n")
    words = ("capture", "pairs", folder, "--preset", preset, "--out", tmp_path / "data")
    done = night_here("night-eval", *words)
    assert done.returncode == 0, done.stderr
    assert "so the wall is taken to be where it is expected" in done.stdout
    made = write_pairs([folder], PRESET, tmp_path / "again")
    assert made.dataset.scene("000000").relay_wall == SCENE.relay_wall
