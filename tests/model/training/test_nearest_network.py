"""What a training for a preset starts from, how long it may be, and what is expected of it."""

import re

import pytest
from night_commands import refusal

from model.training.budget import Speed
from model.training.expectation import CURVES, expected_mae_cm
from model.training.nearest import nearest_network
from model.training.refusals import TrainingError
from scenegen import preset_from_dict

SPEED = Speed(scenes_per_s=100.0, start_s=5.0, validation_s=1.0, no_object_cm=8.0, start_cm=None)


def preset(width, height, mhz=(20, 50, 60), **camera_spread):
    tables = {
        "camera": {"width": width, "height": height},
        "itof": {"frequencies_hz": [1e6 * each for each in mhz]},
        "camera_spread": camera_spread,
    }
    return preset_from_dict(tables, "a test")


@pytest.mark.parametrize(
    ("scenes", "has_sensor", "name", "block"),
    [
        (preset(40, 30), False, "night-40x30", 2),
        (preset(40, 30), True, "night-80x60-camera", 2),
        (preset(20, 15), False, "night-40x30", 1),
        (preset(160, 120), True, "night-80x60-camera", 8),
        (preset(80, 60), False, "night-80x60", 4),
        (preset(80, 60), True, "night-80x60-camera", 4),
        (preset(320, 240), False, "night-80x60", 16),
        (preset(120, 90), False, "night-40x30", 6),
        (preset(80, 60, location_m=0.1), False, "any-corner", 2),
        (preset(32, 24), False, "any-corner", 2),
        (preset(80, 80), False, "any-corner", 2),
        (preset(80, 60, (20, 30, 50, 60)), False, "night-80x60", 4),
        (preset(40, 30, (20, 60)), False, "night-40x30", 2),
        (preset(80, 60, (10, 20, 50, 60)), False, "night-80x60", 4),  # which predicts at 20 MHz
    ],
)
def test_the_nearest_network_has_the_frequencies_the_corners_and_a_part_of_the_size(
    scenes, has_sensor, name, block
):
    found = nearest_network(scenes, has_sensor=has_sensor)
    assert (found.run.name, found.block) == (name, block)
    assert name in found.why
    wanted_hz = scenes.itof.frequencies_hz
    has_all = {20e6, 50e6, 60e6} <= {*wanted_hz} and wanted_hz[0] == 20e6
    assert found.frequencies_hz == ((20e6, 50e6, 60e6) if has_all else wanted_hz)
    assert ("begin with the weights of the nearest" in found.why) != has_all
    own = int(re.search(r"images of (\d+)x", found.why)[1]) if "x" in name else scenes.camera.width
    assert ("images of several sizes" in found.why) == ("x" not in name)
    assert ("a whole part of" in found.why) == (own < scenes.camera.width)
    assert ("a multiple of" in found.why) == (own > scenes.camera.width)


def test_without_one_a_training_starts_from_new_weights_and_says_why():
    far = preset_from_dict({"camera": {"location_m": [7.0, -7.0, 1.65]}}, "a test")  # 20 MHz turns twice
    found = nearest_network(far, has_sensor=False)
    assert (found.run, found.block) == (None, 0)
    assert found.why.startswith("the training starts from new weights: no network of NIGHT is for such depth")


@pytest.mark.parametrize(
    ("budget_s", "scenes"),
    [(7, 64), (8, 128), (9, 256), (60, 256), (120, 512), (1800, 8192), (36_000, 8192)],
)
def test_a_time_gives_as_many_epochs_as_fit_into_it(budget_s, scenes):
    epochs, size = SPEED.epochs_in(budget_s)
    assert size == scenes
    assert SPEED.seconds(epochs, size) <= budget_s < SPEED.seconds(epochs + 1, size)


def test_a_time_that_is_too_short_for_an_epoch_is_refused_with_one_that_is_not():
    with pytest.raises(
        TrainingError, match=r"6 s is too small: one epoch of 32 scenes takes 6.32 s here; give 62"
    ):
        SPEED.epochs_in(6.0)


@pytest.mark.parametrize("kind", CURVES)
def test_the_expected_error_is_that_of_the_measured_points_and_falls_between_and_beyond(kind):
    one_corner, has_start = kind
    worst_cm = 100.0 if has_start else None

    def expected(samples, start_cm=worst_cm):
        return expected_mae_cm(samples, 10.0, one_corner=one_corner, start_cm=start_cm)

    for samples, share in CURVES[kind]:
        assert expected(samples) == pytest.approx(10.0 * share)
    errors = [expected(samples) for samples in (16_384, 100_000, 10**6, 10**7)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] > 0
    assert expected(CURVES[kind][0][0] - 1) is None  # nobody has measured so few
    if has_start:
        assert expected(20_000, start_cm=0.5) == 0.5  # never worse than the start


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--budget", "5"), "'5' is no time; write it like 90s, 30min or 2h"),
        (("--budget", "0min"), "'0min' is no time"),
        (("--budget", "1min", "--max-epochs", 3), "both say how long to train"),
        (("--budget", "1min", "--set", "run.max_epochs=3"), "both say how long to train"),
        (("--budget", "1min", "--preset", "demo"), "both say how long to train"),
        (
            ("--set", "run.patience=3", "--set", "run.epoch_scenes=9"),
            "decides run.epoch_scenes and run.patience",
        ),
        (("--fresh", "paper"), "leave --fresh out"),
        (("--set", "run.ground_truth=simulated"), "fresh scenes have no simulated ground truth"),
        (("--sensor", "mlx75027"), "the camera sees 60 degrees and the scenes of "),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_made(tmp_path, words, sentence):
    file = tmp_path / "mine.toml"
    file.write_text("[camera]\nwidth = 40\nheight = 30\nhorizontal_fov_deg = 50.0\n")
    assert sentence in refusal("night-train", "--for", file, "--out", tmp_path / "run", *words)
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[camera]\nrotation_deg = [90.0, 0.0, 230.0]", "camera"),
        ("[transient]\nmax_bounces = 4", "fresh scenes have 3 bounces, and the preset asks for 4"),
        ("[projector]\ndots = [1, 1]", "has a projector of its own"),
        ('[dataset]\nframe_rate_hz = 10\n[[object]]\nshape = "cube"\nsize_m = 0.2', "is of a sequence"),
        ("[itof]\nfrequencies_hz = [60e6]", "put a lower frequency first"),
    ],
)
def test_a_preset_that_no_network_can_be_trained_for_is_refused_at_once(tmp_path, text, sentence):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert sentence in refusal("night-train", "--for", file, "--out", tmp_path / "run")
    assert list(tmp_path.iterdir()) == [file]


def test_a_dataset_a_preset_and_a_budget_go_with_what_they_are_for(closed_form_scenes, tmp_path):
    out = ("--out", tmp_path / "run")
    assert "leave DATASET out" in refusal("night-train", closed_form_scenes.root, "--for", "paper", *out)
    assert "--budget goes with --for" in refusal(
        "night-train", closed_form_scenes.root, "--budget", "1h", *out
    )
    assert "give DATASET, or --for PRESET" in refusal("night-train", *out)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").touch()
    assert "is not empty and holds no run" in refusal("night-train", "--for", "paper", *out)
