"""Contact sheets and plots of a dataset: what they draw is what the files hold."""

import io
import os
from collections import Counter

import numpy as np
import pytest
from matplotlib.figure import Figure
from previews import RENDERED, grey_view
from render_records import record_anew

from itof import amplitude, direct_phasors, phase, read_image, write_image
from render.products.contact_sheet import choose_scenes, contact_sheet
from render.products.distributions import balance_sentence, distributions_figure, read_distributions
from render.products.tiles import class_name, read_tile
from scenegen import camera_axes, wall_normal


def test_a_tile_holds_what_was_rendered(corners):
    for scene_id in RENDERED:
        tile = read_tile(corners, scene_id, grey_view(None, 4, 3))
        image = read_image(corners.render_folder(scene_id) / "itof.exr")
        truth = read_image(corners.render_folder(scene_id) / "mirrored.exr")
        np.testing.assert_array_equal(tile.measured, amplitude(image.phasors()[0])[..., 0])
        np.testing.assert_array_equal(tile.hidden, amplitude(image.phasors("hidden")[0])[..., 0])
        depth_m, mask = truth.channel("depth.R"), truth.channel("mask.M") > 0
        np.testing.assert_array_equal(tile.radial_depth_m[mask], depth_m[mask])
        assert np.isnan(tile.radial_depth_m[~mask]).all()
        entry, roughness = (corners.entry(scene_id), corners.scene(scene_id).relay_wall.roughness)
        words = (scene_id, entry.object_class.replace("_", " "), entry.split, f"roughness {roughness:.2f}")
        assert tile.title.split("   ") == list(words)


def test_a_class_of_any_name_is_no_formula():
    figure = Figure()
    figure.text(0, 0, class_name("mesh:$^$.ply"))
    figure.savefig(io.BytesIO(), format="png")  # Matplotlib would raise for a wrong formula
    assert class_name("mesh:folder/a_b.ply") == "a b.ply"


def test_the_sheet_draws_the_tiles_arrays_and_says_what_is_not_rendered(corners):
    tiles = [read_tile(corners, scene_id, grey_view(None, 4, 3)) for scene_id in ("000000", "000002")]
    figure = contact_sheet(tiles)
    drawn = [panel.images[0].get_array() for panel in figure.axes[:4]]
    for values, expected in zip(drawn, (tiles[0].view, tiles[0].measured, tiles[0].hidden), strict=False):
        np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(np.ma.filled(drawn[3], np.nan), tiles[0].radial_depth_m)
    assert (tiles[1].measured, tiles[1].hidden, tiles[1].radial_depth_m) == (None, None, None)
    for panel in figure.axes[5:8]:
        assert len(panel.images) == 0
        assert [text.get_text() for text in panel.texts if "rendered" in text.get_text()] == ["not rendered"]


def test_without_parts_the_sheet_shows_what_no_direct_light_explains(corners):
    # Light of phase a in front of the wall's own, b behind: only sin(a) and sin(b) of it is no direct light.
    scene = corners.scene("000000")
    wall, camera = scene.relay_wall, scene.camera
    direct = direct_phasors(
        *(24, 18, camera.horizontal_fov_deg, [20e6], camera_axes(camera), camera.location_m),
        *(wall.location_m, wall_normal(wall)),
    )[..., 0]
    lag = np.linspace(0, 1, 24)[None, :] * np.ones((18, 1))
    phasor = 0.7 * direct + 0.01 * np.exp(1j * (phase(direct) + lag))
    channels = {"itof.20MHz.Re": phasor.real, "itof.20MHz.Im": phasor.imag}
    write_image(corners.render_folder("000000") / "itof.exr", channels, {})
    record_anew(corners.render_folder("000000"))
    tile = read_tile(corners, "000000", grey_view(None, 4, 3))
    assert tile.hidden_is_residual
    np.testing.assert_allclose(tile.hidden, 0.01 * np.sin(lag), atol=1e-6 * np.abs(phasor).max())
    headings = {text.get_text() for panel in contact_sheet([tile]).axes for text in panel.texts}
    assert "residual of the wall" in headings


def test_scenes_are_chosen_evenly_over_classes_and_splits(make_dataset):
    dataset = make_dataset({"dataset": {"count": 70}})
    chosen = choose_scenes(dataset, 14)
    assert chosen == sorted(set(chosen))
    entries = [dataset.entry(scene_id) for scene_id in chosen]
    assert set(Counter(entry.object_class for entry in entries).values()) == {2}
    splits = Counter(entry.split for entry in entries)
    assert min(splits[split] for split in ("train", "validation", "test")) >= 4
    assert choose_scenes(dataset, 99) == dataset.ids()


def test_rendered_scenes_are_chosen_first_within_a_class(corners):
    assert set(RENDERED) <= set(choose_scenes(corners, 7))
    assert choose_scenes(corners, 9) == corners.ids()


# Distributions


def test_the_pixel_ratio_is_that_of_the_masks(corners):
    steps = []
    found = read_distributions(corners, lambda: steps.append(1))
    assert len(steps) == 9
    masks = [read_image(corners.render_folder(i) / "mirrored.exr").channel("mask.M") for i in RENDERED]
    background, on_object = sum((m == 0).sum() for m in masks), sum((m == 1).sum() for m in masks)
    assert found.background_per_object == pytest.approx(background / on_object, rel=1e-12)
    assert found.object_pixels == {i: m.sum() for i, m in zip(RENDERED, masks, strict=True)}
    assert found.image_sizes == ((24, 18),)
    assert balance_sentence(found) == f"background/object {background / on_object:.1f} (released code: 30.2)"


def test_every_drawn_object_falls_into_a_bin(corners):
    found = read_distributions(corners, lambda: None)
    scenes = [corners.scene(scene_id) for scene_id in corners.ids()]
    places = [scene.hidden_objects[0].location_m for scene in scenes]
    np.testing.assert_array_equal(found.locations_m, places)
    parts = sum(len(scene.hidden_objects) for scene in scenes)
    assert parts > len(scenes)  # a composite is among them
    panels = distributions_figure(found, corners.preset).axes
    for panel in panels[:6]:
        # Bars of a stack start where the one below ends, so their heights are the counts.
        assert sum(bar.get_height() for bar in panel.patches) == parts
        low, high = sorted(line.get_xdata()[0] for line in panel.lines)
        ranges = corners.preset.hidden_object
        group = ranges.location_m if "position" in panel.get_xlabel() else ranges.rotation_deg
        assert (low, high) == getattr(group, panel.get_xlabel().split()[1].rstrip(","))
    assert sum(bar.get_height() for bar in panels[6].patches) == len(scenes)
    assert sum(bar.get_width() for bar in panels[7].patches) == len(scenes)
    assert sum(bar.get_height() for bar in panels[8].patches) == len(RENDERED)


def test_a_point_for_a_range_and_a_diffuse_wall_can_be_drawn(make_dataset):
    point = {"x": [1.1, 1.1], "y": [0.9, 0.9], "z": [1.6, 1.6]}
    settings = {"composite_fraction": 0.0, "location_m": point}
    dataset = make_dataset(
        {"dataset": {"count": 3}, "hidden_object": settings, "relay_wall": {"material": "diffuse"}}
    )
    found = read_distributions(dataset, lambda: None)
    assert found.background_per_object is None
    assert balance_sentence(found) == "no scene is rendered yet"
    figure = distributions_figure(found, dataset.preset)
    assert sum(bar.get_height() for bar in figure.axes[0].patches) == 3
    assert "diffuse" in figure.axes[6].texts[0].get_text()
    assert "no scene is rendered yet" in figure.axes[8].texts[0].get_text()
    figure.savefig(os.devnull, format="png")
