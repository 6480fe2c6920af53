"""The preset of a real corner, from a capture of its empty wall."""

import json
from dataclasses import replace

import numpy as np
import pytest
from measurements import write_npz
from night_commands import night_here, refusal
from wall_measurements import noise

from disk import PresetError
from itof import read_image
from itof.sensor.cameras import load_sensor
from itof.sensor.scene_camera import SceneCamera
from itof.wall.expected_wall import angle_deg, distance_m
from itof.wall.wall_view import WallView
from render import captured_corner
from render.products.corner_facts import corner_facts
from scenegen import load_preset, open_dataset, sample_scene
from scenegen.corner_check import refuse_impossible_corner
from scenegen.corner_geometry import distances_m
from scenegen.pose import camera_axes, wall_geometry
from scenegen.sampling import walls_of

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 40, 30
OFFSET_STD_RAD = 0.1  # of a camera of which nothing else is known
# What these offsets do to a distance that is known from the phase of the highest frequency alone.
LARGEST_STD_M = OFFSET_STD_RAD / (4 * np.pi * FREQUENCIES_HZ[-1] / 299792458)
SIGMAS = 3.0
ROUNDED_M, ROUNDED_DEG = 1e-4, 1e-3  # the last digit of a preset


def view_of(preset):
    return WallView(**wall_geometry(preset.camera, walls_of(preset)[0]))


def returned(view):
    return view.direct_phasors(WIDTH, HEIGHT, FREQUENCIES_HZ)


def measured(folder, view, seen, name="empty.npz", **more):
    """A measurement file of the phasors `seen` (H, W, F)."""
    arrays = {"phasors": seen, "frequencies_hz": np.array(FREQUENCIES_HZ)}
    return write_npz(folder / name, **arrays, horizontal_fov_deg=view.horizontal_fov_deg, **more)


def looking(right_deg, up_deg, roll_deg=0.0, away_m=1.0):
    """A camera in front of the paper's relay wall, by the turns that make its pose, one after the other."""
    preset = load_preset("paper")
    turn, up, roll = np.radians([right_deg, up_deg, roll_deg])
    forward = np.array([-np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)])
    right = np.array([np.sin(turn), np.cos(turn), 0.0])
    down = np.cross(forward, right)
    axes = [np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, forward]
    view = view_of(preset)
    return replace(view, camera_axes=tuple(map(tuple, axes)), camera_location_m=(away_m, 0.2, 1.5))


def as_it_is(z, rng):
    return z


def with_noise(z, rng):
    return z * (1 + 1e-3 * noise(z.shape, rng.integers(100)))


def by_a_camera(z, rng):
    camera = replace(load_sensor("mlx75027"), width=4 * WIDTH, height=4 * HEIGHT)
    return SceneCamera(camera, FREQUENCIES_HZ, WIDTH, HEIGHT).measure(z, z, 0 * z, rng).phasor


@pytest.mark.parametrize("seen", [as_it_is, with_noise, by_a_camera])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_the_camera_of_the_preset_sees_the_wall_where_the_camera_of_a_drawn_corner_saw_it(
    tmp_path, index, seen
):
    corner = load_preset("any-corner")
    view = view_of(replace(corner, camera=sample_scene(corner, index).camera))
    file = measured(tmp_path, view, seen(returned(view), np.random.default_rng(index)))
    found = captured_corner(file)
    assert found.doubts == ()
    away_m, *angles_deg = found.std
    assert away_m < LARGEST_STD_M
    true, plane = view.plane_per_m, view_of(found.preset).plane_per_m
    assert distance_m(plane) == pytest.approx(distance_m(true), abs=SIGMAS * away_m)
    assert angle_deg(plane, true) < SIGMAS * np.hypot(*angles_deg)
    camera = found.preset.camera
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert camera.horizontal_fov_deg == view.horizontal_fov_deg
    assert found.preset.itof.frequencies_hz == FREQUENCIES_HZ


@pytest.mark.parametrize(
    ("right_deg", "up_deg", "roll_deg"), [(40, 0, 0), (-30, 10, 0), (20, -15, 8), (35, 0, 90), (-35, 5, 180)]
)
def test_the_pose_is_that_of_a_camera_before_a_plumb_wall_with_a_known_roll(
    tmp_path, right_deg, up_deg, roll_deg
):
    """The fit is exact without noise: what is left is the rounding of the angles to 0.001 degrees."""
    view = looking(right_deg, up_deg, roll_deg, away_m=1.2)
    found = captured_corner(measured(tmp_path, view, returned(view)), roll_deg=roll_deg)
    assert found.place == pytest.approx((1.2, right_deg, up_deg), abs=1e-6)
    np.testing.assert_allclose(
        camera_axes(found.preset.camera), view.camera_axes, atol=3 * np.radians(ROUNDED_DEG / 2) + 1e-5
    )
    assert found.preset.camera.location_m[0] == pytest.approx(1.2, abs=ROUNDED_M)
    assert found.hidden == ("left" if right_deg < 0 else "right")


def test_a_mirrored_capture_gives_the_mirrored_corner(tmp_path):
    view = looking(40, 10)
    z = returned(view)
    right, left = (captured_corner(measured(tmp_path, view, each)).preset for each in (z, z[:, ::-1]))
    flipped = np.array([1, -1, 1])
    place = np.array(right.camera.location_m)
    np.testing.assert_allclose(left.camera.location_m, place * flipped, atol=ROUNDED_M)
    mirrored = camera_axes(right.camera) * flipped * np.array([[-1], [1], [1]])
    np.testing.assert_allclose(camera_axes(left.camera), mirrored, atol=np.radians(ROUNDED_DEG))
    low, high = right.hidden_object.location_m.y
    assert left.hidden_object.location_m.y == (-high, -low)
    # Light takes the same ways.
    facts, others = (corner_facts(preset).as_data() for preset in (right, left))
    for name, value in facts.items():
        assert value == pytest.approx(others[name], rel=0.01), name


def test_the_paper_s_camera_is_put_where_the_paper_has_it(tmp_path):
    view = looking(40, 0)
    camera = captured_corner(measured(tmp_path, view, returned(view))).preset.camera
    paper = load_preset("paper").camera
    assert camera.location_m == pytest.approx(paper.location_m, abs=ROUNDED_M)
    assert camera.rotation_deg == pytest.approx(paper.rotation_deg, abs=ROUNDED_DEG)


@pytest.mark.parametrize(
    ("right_deg", "up_deg", "away_m", "hidden"),
    [(0, 0, 1.0, "right"), (20, -10, 2.5, "right"), (35, 5, 0.9, "left"), (-30, 15, 1.8, "left")],
)
def test_the_image_of_an_empty_wall_shows_no_middle_wall(tmp_path, right_deg, up_deg, away_m, hidden):
    view = looking(right_deg, up_deg, away_m=away_m)
    preset = captured_corner(measured(tmp_path, view, returned(view)), hidden=hidden).preset
    refuse_impossible_corner(preset)
    facts = corner_facts(preset)
    assert (facts.middle_wall, facts.gap_m) == (0, pytest.approx(0.7))
    assert facts.camera_m == pytest.approx(away_m, abs=ROUNDED_M)


def test_measures_of_the_user_take_the_place_of_those_of_the_paper(tmp_path):
    view = looking(30, 0, away_m=3.5)
    file = measured(tmp_path, view, returned(view))
    preset = captured_corner(file, gap_m=0.5, aside_m=1.7, hidden="right").preset
    relay, middle = walls_of(preset)
    eye = np.array([preset.camera.location_m])
    assert corner_facts(preset).gap_m == pytest.approx(0.5)
    assert abs(distances_m(middle, eye)) == pytest.approx(1.7)
    assert distances_m(relay, eye) == pytest.approx(3.5, abs=ROUNDED_M)
    assert preset.middle_wall.location_m[0] + preset.middle_wall.size_m[0] / 2 > 3.5  # it hides the region


def test_the_command_writes_a_preset_that_can_be_drawn(tmp_path):
    view = looking(38, 3)
    file, out = (
        measured(tmp_path, view, with_noise(returned(view), np.random.default_rng(0))),
        tmp_path / "my.toml",
    )
    done = night_here("night-eval", "capture", "corner", file, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    assert load_preset(out) == captured_corner(file).preset
    told = json.loads(done.stdout)
    assert told["distance_m"] == pytest.approx(1.0, abs=SIGMAS * told["distance_std_m"])
    drawn = night_here("night-gen", "corner", out, "--out", tmp_path / "my.png")
    assert drawn.returncode == 0, drawn.stderr
    assert "the camera is 1.00 m from the relay wall" in drawn.stdout
    out.write_text("mine")
    command = ("night-eval", "capture", "corner", file, "--out", out)
    assert "my.toml exists already" in refusal(*command)
    assert out.read_text() == "mine"
    assert night_here(*command, "--replace").returncode == 0
    assert load_preset(out) == captured_corner(file).preset


def test_a_rendered_image_shows_its_corner_in_spite_of_its_hidden_object(seven_renders, tmp_path):
    dataset, out = open_dataset(seven_renders), tmp_path / "my.toml"
    image = dataset.render_folder("000000") / "itof.exr"
    assert np.abs(np.subtract(*(read_image(image).phasors(part)[0] for part in ("itof", "direct")))).max() > 0
    done = night_here("night-eval", "capture", "corner", image, "--out", out)
    assert done.returncode == 0, done.stderr
    (away_m, *angles_deg), camera = captured_corner(image).std, load_preset(out).camera
    true = dataset.preset.camera
    assert camera.location_m[0] == pytest.approx(true.location_m[0], abs=SIGMAS * away_m)
    assert camera.rotation_deg == pytest.approx(true.rotation_deg, abs=SIGMAS * max(angles_deg))
    assert camera.horizontal_fov_deg == true.horizontal_fov_deg


def test_the_empty_corner_of_a_measurement_is_looked_at(tmp_path):
    view = looking(40, 0)
    z = returned(view)
    file = measured(tmp_path, view, noise(z.shape), reference=z)
    assert captured_corner(file).place[0] == pytest.approx(1.0, abs=1e-6)


def test_a_wall_whose_place_is_not_certain_is_written_only_when_forced(tmp_path):
    view, out = looking(40, 0), tmp_path / "my.toml"
    offsets = np.exp(1j * np.array([0.5, 1.4, -2.0]))
    file = measured(tmp_path, view, returned(view) * offsets)
    command = ("night-eval", "capture", "corner", file, "--out", out)
    said = refusal(*command)
    assert "the wall's distance is uncertain by" in said
    assert not out.exists()
    done = night_here(*command, "--force")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("warning: the wall's distance is uncertain by")
    assert load_preset(out).camera.width == WIDTH


def test_a_network_for_a_capture_needs_what_it_does_not_show(tmp_path):
    view, command = looking(40, 0), ("night-train", "--out", tmp_path / "run", "--for")
    file = measured(tmp_path, view, returned(view))
    assert "shows neither the middle wall nor the hidden region: give --gap METRES" in refusal(*command, file)
    assert "which must hide the object" in refusal(*command, file, "--gap", "1.5")
    assert "--gap is for an imported capture" in refusal(*command, "paper", "--gap", "0.7")
    np.savez(tmp_path / "raw.npz", raw=np.zeros((4, 6, 8)))
    for raw in ("raw.npz", "raw.mat"):
        said = refusal(*command, tmp_path / raw, "--gap", "0.7")
        assert f"night-eval capture import {tmp_path / raw} --sidecar FILE --out OUT.npz" in said
    unknown = measured(tmp_path, view, returned(view) * np.exp([0.5j, 1.4j, -2.0j]), "unknown.npz")
    said = refusal(*command, unknown, "--gap", "0.7")
    assert "the wall's distance is uncertain by" in said
    assert "night-eval capture corner" in said
    assert {each.name for each in tmp_path.iterdir()} == {"empty.npz", "unknown.npz", "raw.npz"}


@pytest.mark.parametrize("options", [(), ("--force",)])
def test_what_shows_no_wall_gives_no_preset(tmp_path, options):
    view, out = looking(40, 0), tmp_path / "my.toml"
    command = ("night-eval", "capture", "corner", "--out", out, *options)
    dark = measured(tmp_path, view, noise(returned(view).shape), "noise.npz")
    assert "noise.npz shows no wall: the phases at 20, 50, 60 MHz are noise" in refusal(*command, dark)
    several = measured(tmp_path, view, np.stack([returned(view)] * 2), "two.npz")
    assert "two.npz holds 2 images" in refusal(*command, several)
    assert "must end in .toml" in refusal("night-eval", "capture", "corner", dark, "--out", tmp_path / "my")
    assert not out.exists()


def test_a_corner_that_cannot_be_as_assumed_is_written_and_then_refused(tmp_path):
    view, out = looking(40, 0), tmp_path / "my.toml"
    file = measured(tmp_path, view, returned(view))
    done = night_here("night-eval", "capture", "corner", file, "--out", out, "--gap", "1.5")
    assert done.returncode == 2
    assert "my.toml needs measures of your corner" in done.stderr
    assert corner_facts(load_preset(out)).gap_m == pytest.approx(1.5)


def test_numbers_beyond_those_of_a_preset_are_refused_by_name(tmp_path):
    view = looking(40, 0)
    file = measured(tmp_path, view, returned(view))
    with pytest.raises(PresetError, match=r"empty.npz: middle_wall\.\w+"):
        captured_corner(file, gap_m=1e9)


def test_the_wall_of_the_preset_fills_the_image_as_that_of_the_capture(tmp_path):
    """Also where it is far, and the camera is turned along it: the paper's wall would end in the image."""
    view = looking(28.0, 0.0, away_m=5.0)
    found = captured_corner(measured(tmp_path, view, returned(view)))
    assert corner_facts(found.preset).nothing == 0
