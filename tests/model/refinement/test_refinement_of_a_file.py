"""``night-eval refine`` on one measurement: the corner from a room, or none."""

import json

import numpy as np
import pytest
from night_commands import night_here, refusal
from PIL import Image
from render_runs import render_scenes

import model
from itof import DepthMap, read_image
from itof.pictures.plan import MIDDLE
from itof.wall.expected_wall import ExpectedWall
from model.refinement.light.corner_light import CornerLight
from model.refinement.room import corner_of
from scenegen import preset_from_dict
from scenegen.pose import camera_axes

pytestmark = pytest.mark.usefixtures("one_thread")
RUN = "night-40x30"


@pytest.fixture(scope="module")
def dataset(make_dataset):
    made = make_dataset(
        {
            "dataset": {"count": 2, "seed": 92},
            "hidden_object": {
                "shapes": ["cube", "sphere"],
                "composite_fraction": 0.0,
                "size_m": {"sphere": [0.46, 0.46, 0.46]},
                "reflectance": 0.7,
            },
        }
    )
    render_scenes(made.root, product="itof", resolution=(40, 30), error=0.005)
    return made


@pytest.fixture(scope="module")
def measured(dataset, tmp_path_factory):
    """A file without anything that a dataset knows: a sphere in a camera's own unit."""
    phasors, hz = read_image(dataset.render_folder("000001") / "itof.exr").phasors()
    file = tmp_path_factory.mktemp("measured") / "sphere.npz"
    np.savez(file, phasors=1e4 * phasors, frequencies_hz=np.array(hz))
    return file


@pytest.fixture(scope="module")
def refined(measured, tmp_path_factory):
    """Folder of its refinement, and what the command printed."""
    out = tmp_path_factory.mktemp("refined") / "out"
    done = night_here(
        *("night-eval", "refine", RUN, measured, "--out", out, "--room", "paper", "--device", "cpu")
    )
    assert done.returncode == 0, done.stderr
    return out, done.stdout


@pytest.fixture
def sphere(tmp_path):
    """A preset in which there is nothing but a sphere."""
    file = tmp_path / "sphere.toml"
    file.write_text('[hidden_object]\nshapes = ["sphere"]\ncomposite_fraction = 0.0\n')
    return file


def test_place_size_and_reflectance_of_a_solid_are_found_from_a_file(refined, dataset):
    out, said = refined
    record = json.loads((out / "prediction.json").read_text())
    (image,) = record["images"]
    found, (true,) = image["explanation"], dataset.scene("000001").hidden_objects
    assert found["accepted"]
    assert found["solids"][0]["shape"] == "sphere"
    # A larger and darker sphere has nearly the same light: 0.5 % of noise tells them apart to some per cent.
    # The light goes with the area, so the reflectance is known half as well as the size.
    np.testing.assert_allclose(found["solids"][0]["size_m"], true.size_m, rtol=0.1)
    assert found["reflectance"] == pytest.approx(true.reflectance, rel=2 * 0.1)
    away_m = np.array(found["solids"][0]["location_m"]) - true.location_m
    # A centimetre is 0.4 % of the way, as in test_refinement_command.
    assert (np.abs(away_m) < 0.01 + 3 * np.array(found["solids"][0]["location_std_m"])).all()
    assert image["expected_mae_m"] == found["expected_mae_m"]
    assert "a sphere leaves" in said
    truth = DepthMap.read(dataset.render_folder("000001") / "mirrored.exr")
    written = DepthMap.read(out / "000000.exr")
    network = model.load(RUN, "cpu").predict(
        read_image(dataset.render_folder("000001") / "itof.exr").phasors()[0]
    )
    errors_m = [np.abs(each.depth - truth.depth).mean() for each in (written, network)]
    # Each wrong pixel at the edge costs 0.25 cm, and a size that is known to 3 % has a few of them.
    assert errors_m[0] < 0.7 * errors_m[1]


def test_a_room_may_be_off_by_centimetres(dataset, measured, tmp_path):
    room = preset_from_dict({"camera": {"location_m": [1.2, -0.98, 1.65]}}, "a test")  # 20 and 2 cm away
    sphere = {"shapes": ["sphere"], "composite_fraction": 0.0, "size_m": {"sphere": [0.46, 0.46, 0.46]}}
    objects = preset_from_dict({"hidden_object": sphere | {"reflectance": 0.7}}, "a test")
    done = model.refine(
        *(RUN, measured, tmp_path / "out"), room=room, objects=objects, device="cpu", progress=False
    )
    found, (true,) = done.images[0].explanation, dataset.scene("000001").hidden_objects
    assert found.accepted
    moved_m = np.array(found.solids[0].location_m) - true.location_m
    np.testing.assert_allclose(moved_m, [0, 0.02, 0], atol=0.01)  # with the camera, along the wall


@pytest.mark.parametrize("turned_deg", [0, 25])
def test_without_a_room_all_of_the_image_shows_the_relay_wall(turned_deg):
    angle = np.radians(turned_deg)
    normal = np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.8])
    wall = ExpectedWall.of_plane(normal / 1.3, 16, 12, (20e6, 50e6), 60.0)
    corner = corner_of(None, wall, 60.0)
    assert CornerLight((20e6,)).sees_wall([corner], wall.rays.reshape(-1, 3)).all()
    place = np.array(corner.relay_wall.location_m) - corner.camera.location_m
    assert camera_axes(corner.camera) @ place @ wall.plane_per_m == pytest.approx(1)


def test_the_picture_shows_what_the_solid_leaves(refined):
    record = json.loads((refined[0] / "prediction.json").read_text())
    assert "000000_light.png" in record["images"][0]["files"]
    with Image.open(refined[0] / "000000_light.png") as picture:
        assert min(picture.size) > 500
    with Image.open(refined[0] / "000000.png") as picture:
        assert sum((np.asarray(picture) == MIDDLE).all(axis=-1).flat) > 200  # the room's middle wall


def test_a_refinement_is_replaced_as_a_prediction_is(measured, sphere, tmp_path):
    command = (
        "night-eval",
        "refine",
        RUN,
        measured,
        "--out",
        tmp_path / "out",
        "--objects",
        sphere,
        "--force",
    )
    first, again = (night_here(*command, "--device", "cpu") for _ in range(2))
    assert first.returncode == 0, first.stderr
    assert again.stdout == first.stdout


def test_only_given_solids_are_tried_and_what_does_not_explain_the_light_is_no_answer(measured, tmp_path):
    objects = preset_from_dict(
        {"hidden_object": {"shapes": ["concave_plane"], "composite_fraction": 0.0}}, "a test"
    )
    done = model.refine(*(RUN, measured, tmp_path / "out"), objects=objects, device="cpu", progress=False)
    (image,) = done.images
    assert not image.explanation.accepted
    assert image.explanation.solids[0].size_m == objects.hidden_object.size_m.concave_plane
    assert "no solid is accepted; the best, a concave plane, leaves" in image.sentence


ROOMS = {
    "[camera]\nrotation_deg = [90.0, 0.0, -130.0]": "the relay wall of the room is behind its camera",
    "[camera]\nlocation_m = [3.0, -2.0, 1.65]": "the room has its relay wall 3.00 m from the camera, the "
    "measurement shows it at 1.00 m",
    "[middle_wall]\nlocation_m = [0.5, -0.5, 2.0]\nrotation_deg = [90.0, 0.0, 50.0]": "the camera of the "
    "room sees nothing of its relay wall, or the middle wall hides all of it",
}


@pytest.mark.parametrize("words", ROOMS, ids=["behind", "far", "hidden"])
def test_rooms_that_cannot_be_are_named(measured, tmp_path, words):
    room = tmp_path / "room.toml"
    room.write_text(words)
    sentence = refusal(
        *("night-eval", "refine", RUN, measured, "--out", tmp_path / "out", "--room", room, "--device", "cpu")
    )
    assert sentence.startswith(ROOMS[words])
    assert not (tmp_path / "out").exists()


def test_options_of_a_dataset_and_of_a_file_are_not_mixed(measured, dataset, tmp_path):
    out = ("--out", tmp_path / "out")
    said = refusal("night-eval", "refine", RUN, measured, *out, "--workers", 2, "--split", "test")
    assert said == f"--split, --workers: for a dataset, which {measured} is not; leave it out"
    said = refusal("night-eval", "refine", RUN, dataset.root, *out, "--room", "paper", "--fov", 60)
    assert said == f"--fov, --room: for a file with a measurement, which {dataset.root} is not; leave it out"
    for option in ("--rescale", "--no-rescale"):
        assert "for a file with a measurement" in refusal(
            "night-eval", "refine", RUN, dataset.root, *out, option
        )
    said = refusal("night-eval", "refine", RUN, measured, *out, "--largest-misfit", "nan")
    assert said == "the largest misfit is a number above 0, got nan"


def test_whether_images_are_rescaled_is_passed_on(measured, sphere, tmp_path):
    for option, rescaled in (("--no-rescale", False), ("--rescale", True)):
        done = night_here(
            *("night-eval", "refine", RUN, measured, "--out", tmp_path / "out", "--device", "cpu", option),
            *("--objects", sphere, "--force", "--json"),
        )
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["rescaled"] == rescaled


def test_files_that_the_network_cannot_read_are_named_as_by_predict(measured, tmp_path):
    with np.load(measured) as arrays:
        phasors, hz = arrays["phasors"], arrays["frequencies_hz"]
    cases = {
        "two": ({"phasors": phasors[..., :2], "frequencies_hz": hz[:2]}, "the network also needs 60 MHz"),
        "wide": ({"phasors": phasors[:20], "frequencies_hz": hz}, "holds images of 40x20 pixels"),
    }
    for name, (arrays, words) in cases.items():
        np.savez(tmp_path / f"{name}.npz", **arrays)
        given = (RUN, tmp_path / f"{name}.npz", "--out", tmp_path / "out", "--room", "paper")
        assert words in refusal("night-eval", "refine", *given, "--device", "cpu")
