"""What each network needs, and what a refusal of one says to do."""

import json

import numpy as np
import pytest
from night_commands import night_here, refusal
from synthetic_dataset import closed_form

from model.prediction.measurement_check import check_file
from model.run_folder.networks import View, Wanted, fitting, networks, readers, table, what_to_do
from model.run_folder.run_config import read_config
from model.run_folder.shipped import shipped_runs
from scenegen import preset_from_dict, sample_scene

MHZ = (20e6, 50e6, 60e6)
MAKE = "night-train --for PRESET --out RUN makes a network"


def measurement(folder, width, height, frequencies_hz, fov_deg):
    """File of a closed-form measurement in the paper's corner."""
    tables = {"camera": {"width": width, "height": height, "horizontal_fov_deg": fov_deg}}
    scene = sample_scene(preset_from_dict(tables, "a test"), 0)
    phasors, _, _ = closed_form(scene, frequencies_hz, width, height)
    file = folder / "m.npz"
    np.savez(file, phasors=phasors, frequencies_hz=frequencies_hz, horizontal_fov_deg=fov_deg)
    return file


def seen_by(name):
    """The view of the middle of a network's training."""
    config = read_config(shipped_runs()[name])
    return View(60.0, tuple(config.geometry.plane_per_m.tolist()))


def test_every_network_that_comes_with_the_program_is_listed_with_what_its_files_say():
    found = {network.name: network for network in networks()}
    assert found.keys() == shipped_runs().keys()
    for name, network in found.items():
        assert network.any_size or f"{network.width}x{network.height}" in name
        assert network.frequencies_hz == MHZ
        assert (network.wall_shift_m > 0) == name.startswith("any-corner")
        assert network.is_of_camera == network.saw_captures == name.endswith("-camera")
        card = (shipped_runs()[name] / "README.md").read_text()
        assert f"{network.width} x {network.height} pixels" in card
        least_deg, most_deg = network.fields_of_view_deg
        assert round(least_deg) == (55 if name.startswith("any") else 60)
        assert round(most_deg) == (65 if name.startswith("any") else 60)
    assert len(table(list(found.values())).splitlines()) == 1 + len(found)


def test_the_command_lists_run_folders_too_and_their_numbers_are_those_of_the_kept_epoch(finished_run):
    done = night_here("night-eval", "networks", finished_run, "night-40x30", "--json")
    own, shipped = json.loads(done.stdout)["networks"]
    assert (own["name"], own["width"], own["height"]) == (finished_run.name, 24, 14)
    assert shipped["validation_mae_cm"] == pytest.approx(1.50, abs=0.005)  # the last lines of its history
    assert finished_run.name in done.stderr
    assert "there is no folder nowhere" in refusal("night-eval", "networks", "nowhere")


@pytest.mark.parametrize(
    ("wanted", "names"),
    [
        (Wanted(40, 30, MHZ), ["any-corner", "night-40x30"]),
        (Wanted(40, 30, (10e6, *MHZ)), ["any-corner", "night-40x30"]),
        (Wanted(40, 30, MHZ, (View(64.0),)), ["any-corner"]),
        (Wanted(40, 30, MHZ, (View(64.0), View(70.0))), []),
        (Wanted(40, 30, (20e6, 60e6)), []),
        (Wanted(320, 240, MHZ), ["any-corner"]),
        (Wanted(44, 33, MHZ), ["any-corner"]),
        (Wanted(40, 40, MHZ), []),
        (Wanted(60, 45, MHZ), []),
    ],
)
def test_the_networks_that_fit_images_have_their_size_frequencies_and_fields_of_view(wanted, names):
    assert fitting(wanted) == names
    told = what_to_do(wanted)
    assert told.startswith("take ") if names else told.startswith(MAKE)
    assert all(name in told for name in names)


def test_a_network_of_one_corner_does_not_fit_a_wall_elsewhere():
    there = seen_by("night-40x30")
    nearer = View(60.0, tuple(1.3 * value for value in there.plane_per_m))  # at 1 / 1.3 of the distance
    assert fitting(Wanted(40, 30, MHZ, (there,))) == ["any-corner", "night-40x30"]
    assert fitting(Wanted(40, 30, MHZ, (nearer,))) == ["any-corner"]
    far_away = View(60.0, tuple(0.3 * value for value in there.plane_per_m))
    assert fitting(Wanted(40, 30, MHZ, (far_away,))) == []


def test_raw_frames_can_be_imported_at_the_size_of_a_network():
    names, told = readers(Wanted(320, 240, (*MHZ, 100e6)), can_be_smaller=True)
    assert names == ["any-corner"]
    assert "with --size 40x30: any-corner, night-40x30; with --size 80x60: " in told
    assert MAKE in readers(Wanted(60, 40, MHZ), can_be_smaller=False)[1]
    assert readers(Wanted(60, 40, MHZ), can_be_smaller=True)[1].startswith("with --size 40x30: ")


@pytest.mark.parametrize(
    ("shape", "frequencies_hz", "fov_deg", "reason"),
    [
        ((24, 18), MHZ, 60.0, "holds images of 24x18 pixels"),
        ((40, 30), (20e6, 60e6), 60.0, "the network also needs 50 MHz"),
        ((40, 30), MHZ, 70.0, "the field of view is 70 degrees, and the training saw 60"),
    ],
)
def test_a_measurement_that_no_network_reads_is_refused_with_the_command_that_makes_one(
    tmp_path, shape, frequencies_hz, fov_deg, reason
):
    file = measurement(tmp_path, *shape, frequencies_hz, fov_deg)
    told = refusal("night-eval", "predict", "night-40x30", file, "--out", tmp_path / "out")
    assert reason in told
    assert f"; {MAKE}" in told or f": {MAKE}" in told


def test_a_network_that_was_trained_with_captures_of_the_empty_corner_asks_for_one(tmp_path):
    file = measurement(tmp_path, 80, 60, MHZ, 60.0)
    held = dict(np.load(file))
    with_capture = tmp_path / "with.npz"
    np.savez(with_capture, **held, reference=held["phasors"])
    asked = [
        [finding.code for finding in check_file(run, each, device="cpu").findings].count("no-capture")
        for run in ("night-80x60-camera", "night-80x60")
        for each in (file, with_capture)
    ]
    assert asked == [1, 0, 0, 0]


def test_a_measurement_that_another_network_reads_is_refused_with_its_name(tmp_path):
    file = measurement(tmp_path, 40, 30, MHZ, 64.0)
    told = refusal("night-eval", "predict", "night-40x30", file, "--out", tmp_path / "out")
    assert "take any-corner, which fits" in told


@pytest.mark.parametrize(
    ("width", "readable"), [(40, ["any-corner", "night-40x30"]), (44, ["any-corner"]), (60, [])]
)
def test_the_check_of_a_capture_names_the_networks_that_can_read_it(tmp_path, width, readable):
    file = measurement(tmp_path, width, 30, MHZ, 60.0)
    done = night_here("night-eval", "capture", "check", file, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["networks"] == readable
    last = done.stderr.splitlines()[-1]
    if readable:
        assert last == f"networks that can read it: {', '.join(readable)}"
    else:
        assert last.startswith(f"no network that comes with NIGHT can read it; {MAKE}")
