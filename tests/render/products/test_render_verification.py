"""Verification: what is right passes, and every kind of wrong content is named, even with hashes that fit."""

import dataclasses
import json
import shutil

import numpy as np
import OpenEXR
import pytest
from night_commands import night_here
from render_records import problems, record_anew

from itof import (
    SPEED_OF_LIGHT,
    TransientReader,
    TransientWriter,
    pixel_rays,
    pixel_types,
    read_image,
    write_image,
)
from render.options import ManyLightOptions
from render.products.content_checks import QUADRATURE_SHARE
from render.products.geometry import traced_depth_m
from render.products.verification import verify
from render.rendering import Renderer
from render.settings import RenderSettings
from scenegen import camera_axes, open_dataset, read_record, wall_normal, write_record

SCENES = ("000000", "000003")  # a cube and the composite


@pytest.fixture
def copy(rendered_copy):
    return open_dataset(rendered_copy)


def rewrite(dataset, scene_id, name, change):
    file = dataset.render_folder(scene_id) / name
    image = read_image(file)
    channels = {key: values.copy() for key, values in image.channels.items()}
    change(channels)
    write_image(file, channels, image.attributes)
    record_anew(dataset.render_folder(scene_id))


@pytest.mark.parametrize("workers", [1, 2])
def test_what_was_rendered_is_right(rendered_copy, workers):
    shutil.rmtree(rendered_copy / "renders" / "000005")
    done = night_here("night-render", "verify", rendered_copy, "--workers", workers)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith("6 scenes checked: 6 good, 0 bad")
    assert "1 not rendered" in done.stdout


def test_depth_by_hand_is_that_of_a_sphere(make_dataset):
    shapes = {"shapes": ["sphere"], "composite_fraction": 0.0}
    dataset = make_dataset({"dataset": {"count": 1}, "hidden_object": shapes})
    scene = dataset.scene("000000")
    rows, columns = (grid.ravel() for grid in np.mgrid[0:36, 0:48])
    depth_m = traced_depth_m(dataset, scene.id, (36, 48), rows, columns)
    normal, point = wall_normal(scene.relay_wall), np.array(scene.relay_wall.location_m)
    centre = np.array(scene.hidden_objects[0].location_m)
    centre = centre - 2 * ((centre - point) @ normal) * normal
    rays = pixel_rays(48, 36, scene.camera.horizontal_fov_deg)[rows, columns] @ camera_axes(scene.camera)
    towards = centre - np.array(scene.camera.location_m)
    along = rays @ towards
    apart = towards @ towards - along**2
    radius_m = scene.hidden_objects[0].size_m[0] / 2
    hit = apart < (0.98 * radius_m) ** 2  # the mesh's edges lie inside the sphere
    expected_m = along[hit] - np.sqrt(radius_m**2 - apart[hit])
    # A facet lies up to r (1 - cos(pi/64)^2) inside, seen at up to 1/0.2 at 98 % of the radius.
    np.testing.assert_allclose(depth_m[hit], expected_m, atol=5 * radius_m * (np.pi / 64) ** 2)
    assert hit.sum() > 20
    assert not depth_m[apart > radius_m**2].any()


def shifted_depth(channels):
    channels["depth.R"] += np.float32(0.002) * channels["mask.M"]
    z = channels["mask.M"] * np.exp(4j * np.pi * 20e6 / SPEED_OF_LIGHT * channels["depth.R"])
    channels["itof.20MHz.Re"], channels["itof.20MHz.Im"] = z.real.copy(), z.imag.copy()


def flipped(channels):
    for name, values in channels.items():
        channels[name] = values[:, ::-1].copy()


def with_nan(channels):
    channels["hidden.50MHz.Im"][3, 4] = np.nan


def scaled_hidden(channels):
    channels["hidden.60MHz.Re"] *= np.float32(1.1)


def wrong_mask(channels):
    channels["mask.M"][0, 0] = 1 - channels["mask.M"][0, 0]


def wrong_phase(channels):
    channels["itof.20MHz.Im"] *= -1


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("mirrored.exr", shifted_depth, "is not that of the geometry"),
        ("mirrored.exr", flipped, "is not that of the geometry"),
        ("mirrored.exr", wrong_mask, "depth and mask do not fit"),
        ("mirrored.exr", wrong_phase, "phasor and depth do not fit"),
        ("itof.exr", with_nan, "hidden.50MHz.Im holds NaN"),
        ("itof.exr", scaled_hidden, "do not add up"),
        ("itof.exr", flipped, "its phasors at 20, 50, 60 MHz are not those of itof.exr"),
    ],
)
def test_wrong_contents_are_named_though_their_hash_fits(copy, name, change, words):
    rewrite(copy, "000003", name, change)
    report = verify(copy, SCENES)
    assert report.checked == 2
    assert list(report.problems) == ["000003"]
    assert any(words in problem for problem in report.problems["000003"]), report.problems
    assert read_record(copy.render_folder("000003")) is None  # the next run renders it again
    assert read_record(copy.render_folder("000000")) is not None


def test_a_transient_shifted_by_one_bin_is_named(copy):
    file = copy.render_folder("000000") / "transient.exr"
    with TransientReader(file) as reader:
        layout, attributes = reader.layout, reader.attributes
        transient = np.concatenate(list(reader.row_blocks()))
    with TransientWriter(file, layout, attributes) as writer:
        writer.write_rows(np.roll(transient, 1, axis=-1))
    record_anew(copy.render_folder("000000"))
    (problem,) = problems(copy)
    assert "transient.exr: its phasors at 20, 50, 60 MHz are not those of itof.exr (they differ by" in problem


def test_a_transient_with_one_nan_is_named(copy):
    file = copy.render_folder("000000") / "mirrored_transient.exr"
    with TransientReader(file) as reader:
        layout, attributes = reader.layout, reader.attributes
        transient = np.concatenate(list(reader.row_blocks()))
    transient[5, 7, 11] = np.nan
    with TransientWriter(file, layout, attributes) as writer:
        writer.write_rows(transient)
    record_anew(copy.render_folder("000000"))
    assert problems(copy) == ["mirrored_transient.exr holds NaN or infinity"]


def test_half_floats_are_named(copy):
    file = copy.render_folder("000000") / "itof.exr"
    image = read_image(file)
    halves = {name: values.astype(np.float16) for name, values in image.channels.items()}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, halves) as exr:
        exr.write(str(file))
    assert set(pixel_types(file).values()) == {"HALF"}
    record_anew(copy.render_folder("000000"))
    assert any("another type than float32" in problem for problem in problems(copy))


def test_a_render_of_another_scene_than_the_dataset_has_is_named(copy):
    record = read_record(copy.render_folder("000000"))
    recipe = json.loads(record.recipe) | {"scene_sha256": copy.entry("000003").sha256}
    write_record(copy.render_folder("000000"), dataclasses.replace(record, recipe=json.dumps(recipe)))
    assert problems(copy) == ["the scene was changed after it was rendered"]


def test_a_render_of_another_size_than_recorded_is_named(copy):
    folder = copy.render_folder("000000")
    record = read_record(folder)
    recipe = json.loads(record.recipe) | {"size": [12, 9]}
    write_record(folder, dataclasses.replace(record, recipe=json.dumps(recipe)))
    assert any("24x18 pixels instead of 12x9" in problem for problem in problems(copy))


def test_the_tolerance_of_binned_phasors_lies_between_right_and_one_bin_off(seven_renders):
    folder = seven_renders / "renders" / "000000"
    image = read_image(folder / "itof.exr")
    exact, frequencies_hz = image.phasors()
    hidden = np.linalg.norm(image.phasors("hidden")[0], axis=(0, 1))
    with TransientReader(folder / "transient.exr") as reader:
        binned = reader.phasors(frequencies_hz)
        axis = reader.layout
    assert np.all(np.linalg.norm(binned - exact, axis=(0, 1)) < QUADRATURE_SHARE / 2 * hidden)
    turn = np.exp(2j * np.pi * np.array(frequencies_hz) * axis.bin_width_m / SPEED_OF_LIGHT)
    assert np.all(np.linalg.norm(binned * turn - exact, axis=(0, 1)) > 2 * QUADRATURE_SHARE * hidden)


@pytest.mark.parametrize("bin_width_m", [0.01, 0.05])
def test_wide_bins_and_high_frequencies_are_judged_by_what_bins_resolve(make_dataset, variant, bin_width_m):
    dataset = make_dataset(
        {
            "dataset": {"count": 1},
            "camera": {"width": 24, "height": 18},
            "itof": {"frequencies_hz": [20e6, 60e6, 100e6, 200e6, 400e6]},
            "transient": {"bin_count": int(16 / bin_width_m), "bin_width_m": bin_width_m},
            "hidden_object": {"shapes": ["concave_plane"], "composite_fraction": 0.0},
            "relay_wall": {"roughness": [0.3]},
        }
    )
    settings = RenderSettings(product="both", options=ManyLightOptions(lights=128), device="cpu")
    Renderer(dataset, settings).render("000000")
    assert problems(dataset) == []
    # A tenth of a bin later: the phasors that bins carry well show it, one by one.
    rewrite(dataset, "000000", "itof.exr", lambda channels: turned(channels, "60MHz", bin_width_m / 10))
    (problem,) = problems(dataset)
    assert "transient.exr: its phasors at 60 MHz are not those of itof.exr" in problem


def turned(channels, name, later_m):
    turn = np.exp(2j * np.pi * float(name.removesuffix("MHz")) * 1e6 * later_m / SPEED_OF_LIGHT)
    for part in ("itof", "direct", "hidden"):
        z = (channels[f"{part}.{name}.Re"] + 1j * channels[f"{part}.{name}.Im"]) * turn
        channels[f"{part}.{name}.Re"], channels[f"{part}.{name}.Im"] = z.real.copy(), z.imag.copy()
