"""The transient vector of a pixel: direct and hidden light told apart by time, and its picture."""

import dataclasses
import json

import numpy as np
import pytest
from exported_scene import BIN_M, BINS, HEIGHT, START_M, WIDTH, footprint_m
from night_commands import night_here, refusal
from PIL import Image

from itof import MeasurementMatrix, TransientLayout, TransientReader, TransientWriter, read_image
from render.products.conversion import ExportError
from render.products.tiles import read_tile
from render.products.transient_parts import _shortest_way_m, direct_end_m, first_hidden_bin, hidden_start_m
from render.products.transient_plot import pixel_transient, transient_figure, write_transient_plot

HZ = (20e6, 50e6, 60e6)
LAYOUT = TransientLayout(WIDTH, HEIGHT, BINS, BIN_M, START_M)
CENTRES_M = START_M + (np.arange(BINS) + 0.5) * BIN_M
REACH_M = 1.5 * BIN_M  # the quadratic splat spreads a return over bins whose centres are so near


@pytest.fixture(scope="module")
def scene(transient_dataset):
    return transient_dataset.scene("000000")


@pytest.fixture(scope="module")
def is_hidden(scene):
    """(H, W, T) the bins without direct light."""
    return np.arange(BINS) >= first_hidden_bin(scene, LAYOUT)[..., None]


def test_the_direct_return_ends_at_the_farthest_point_of_the_pixels_footprint(scene):
    longest_m = footprint_m(scene, fine=64)[1]  # of points that stop 1/128 pixel before the corners
    ends_m = direct_end_m(scene, LAYOUT)
    assert np.all(ends_m > longest_m)
    # From there to the corner it grows by a 128th of what it grows over a pixel, in x and in y.
    step_m = max(np.abs(np.diff(longest_m, axis=axis)).max() for axis in (0, 1))
    np.testing.assert_allclose(ends_m, longest_m, atol=2 * step_m / 128)


def test_where_a_pixel_looks_past_the_wall_the_direct_return_ends_at_the_walls_farthest_corner(scene):
    wall, camera = scene.relay_wall, scene.camera
    past = dataclasses.replace(camera, rotation_deg=(90.0, 0.0, -90.0))  # away from the wall x = 0
    x, y, z = camera.location_m
    assert (wall.size_m, wall.location_m) == ((4.0, 8.0), (0.0, 0.0, 2.0))
    farthest_m = np.sqrt(x**2 + (4 - y) ** 2 + max(z, 4 - z) ** 2)
    ends_m = direct_end_m(dataclasses.replace(scene, camera=past), LAYOUT)
    np.testing.assert_allclose(ends_m, 2 * farthest_m, rtol=1e-12)
    assert direct_end_m(scene, LAYOUT).max() < 2 * farthest_m


def test_the_bins_after_the_direct_return_have_the_phasors_of_the_hidden_part(
    transient_dataset, transient_bins, is_hidden
):
    phi = MeasurementMatrix(HZ, BINS, BIN_M, START_M, splat="quadratic")
    image = read_image(transient_dataset.render_folder("000000") / "itof.exr")
    for name, chosen in (("hidden", is_hidden), ("direct", ~is_hidden)):
        exact = image.phasors(name)[0]
        z = phi.apply_streaming([np.where(chosen, transient_bins, 0)])
        # 1 % of the hidden part, as for all bins (docs/science/renderer.md). A bin on the wrong side is
        # direct light, hundreds of times more, or hidden light that is missing here.
        hidden = np.linalg.norm(image.phasors("hidden")[0], axis=(0, 1))
        assert np.all(np.linalg.norm(z - exact, axis=(0, 1)) < 0.01 * hidden)


def test_no_hidden_light_arrives_before_the_shortest_way_over_the_object(
    transient_dataset, transient_bins, scene, is_hidden
):
    lit = (transient_bins > 0) & is_hidden
    first_m = CENTRES_M[lit.argmax(axis=-1)]
    seen = lit.any(axis=-1)
    assert seen.mean() > 0.9
    rows, columns = (index.ravel() for index in np.mgrid[0:HEIGHT:4, 0:WIDTH:3])
    bounds_m = np.array(
        [
            hidden_start_m(transient_dataset, scene, LAYOUT, *place)
            for place in zip(rows, columns, strict=True)
        ]
    )
    seen = seen[rows, columns]
    assert np.all(first_m[rows, columns][seen] > bounds_m[seen] - REACH_M)
    # And it is no weak bound: it lies behind the direct return, so that it can tell that bins are not shared.
    assert np.all(bounds_m - REACH_M > direct_end_m(scene, LAYOUT)[rows, columns] + REACH_M)


def test_the_shortest_way_over_a_triangle_is_that_over_a_mirror():
    corners = np.array([[[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 9.0, 0.0]]])
    start_m, end_m = np.array([-1.0, 0.2, 0.5]), np.array([0.7, -0.4, 1.1])
    mirrored_m = np.linalg.norm(end_m * [1, 1, -1] - start_m)  # the triangle is in the plane z = 0
    found_m = _shortest_way_m(corners, start_m, end_m, 0.01)
    assert mirrored_m - 0.01 < found_m <= mirrored_m
    between = corners + np.array([0, 0, 0.8])  # the straight way crosses it
    found_m = _shortest_way_m(between, start_m, end_m, 0.01)
    assert np.linalg.norm(end_m - start_m) - 0.01 < found_m <= np.linalg.norm(end_m - start_m)


def test_the_default_pixel_has_the_most_hidden_light(transient_dataset, transient_bins, scene):
    ends_m = footprint_m(scene)[1] + REACH_M + 0.02  # 0.02 m: see the first test
    light = np.where(ends_m[..., None] < CENTRES_M, transient_bins.astype(float), 0).sum(axis=-1)
    row, column = np.unravel_index(light.argmax(), light.shape)
    found = pixel_transient(transient_dataset, "000000")
    assert (found.column, found.row) == (column, row)
    np.testing.assert_array_equal(found.direct + found.hidden, transient_bins[row, column])
    assert found.hidden.sum() == pytest.approx(light.max(), rel=1e-9)
    assert found.hidden_share == pytest.approx(light.max() / transient_bins[row, column].sum(), rel=1e-6)


def test_the_picture_has_time_below_and_its_path_length_above(transient_dataset):
    found = pixel_transient(transient_dataset, "000000", (5, 11))
    figure = transient_figure(found, "000000")
    figure.canvas.draw()
    (panel,) = figure.axes
    curves = {one.get_label().split(":")[0]: one for one in panel.patches if ":" in one.get_label()}
    for name, values in (("direct", found.direct), ("hidden", found.hidden)):
        heights, edges_ns, low = curves[name].get_data()
        np.testing.assert_allclose(heights, np.maximum(values, low))
        np.testing.assert_allclose(edges_ns, found.opl_m / 0.299792458)  # light goes 0.2998 m in a ns
    assert curves["direct"].get_edgecolor() != curves["hidden"].get_edgecolor()
    assert panel.get_yscale() == "log"
    low_ns, high_ns = panel.get_xlim()
    above = panel.child_axes[0]
    np.testing.assert_allclose(above.get_xlim(), [low_ns * 0.299792458, high_ns * 0.299792458])
    assert above.get_xlabel() == "optical path length, m"
    assert panel.get_xlabel() == "time, ns"
    lit_ns = edges_ns[np.flatnonzero(found.hidden > low)]
    assert low_ns < edges_ns[np.flatnonzero(found.direct)[0]]
    assert lit_ns[-1] < high_ns  # all of the hidden light that the scale can show


def test_the_command_draws_a_pixel_and_says_its_share(transient_dataset, tmp_path):
    done = night_here(
        *("night-render", "plot", transient_dataset.root, "000000", "--pixel", "5,11"),
        *("--out", tmp_path / "new" / "x.png"),
    )
    assert done.returncode == 0, done.stderr
    share = pixel_transient(transient_dataset, "000000", (5, 11)).hidden_share
    assert f"pixel 5,11: {share:.2g} of the light is hidden light: " in done.stdout
    with Image.open(tmp_path / "new" / "x.png") as picture:
        assert picture.format == "PNG"
        assert picture.size == (990, 506)
    done = night_here("night-render", "plot", transient_dataset.root, "000000", cwd=tmp_path)
    assert [file.name for file in tmp_path.glob("*.png")] == ["000000_transient.png"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("000000", "--pixel", f"{WIDTH},0"), f"no pixel {WIDTH},0: its pixels are 0,0 to 23,17"),
        (("000000", "--pixel", f"0,{HEIGHT}"), f"no pixel 0,{HEIGHT}"),
        (("000000", "--pixel", "-1,2"), "is no pixel; write it like 12,7"),
        (("000000", "--pixel", "3"), "is no pixel; write it like 12,7"),
        (("000000", "--out", "x.jpg"), "a plot is a .png file"),
        (("000001",), "scene 000001 of"),
        (("000099",), "no scene 000099"),
    ],
)
def test_a_plot_that_cannot_be_made_is_refused(transient_dataset, tmp_path, arguments, words):
    assert words in refusal("night-render", "plot", transient_dataset.root, *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


def replaced(dataset, bins, layout=LAYOUT):
    """The dataset with other bins in its transient, as a program without records writes them."""
    folder = dataset.render_folder("000000")
    with TransientReader(folder / "transient.exr") as reader:
        attributes = reader.attributes
    for file in (folder / "render.json", dataset.renders / "rendering.json"):
        file.unlink(missing_ok=True)
    with TransientWriter(folder / "transient.exr", layout, attributes) as writer:
        writer.write_rows(bins)
    return dataset


def test_a_pixel_without_light_and_bins_that_are_not_finite_are_refused(
    transient_copy, transient_bins, tmp_path
):
    bins = transient_bins.copy()
    bins[3, 4] = 0
    dataset = replaced(transient_copy, bins)
    with pytest.raises(ExportError, match="pixel 4,3 of scene 000000 has no light"):
        pixel_transient(dataset, "000000", (4, 3))
    bins[3, 4, 7] = np.inf
    replaced(dataset, bins)
    for pixel in (None, (4, 3)):
        with pytest.raises(ExportError, match="NaN or infinity"):
            write_transient_plot(dataset, "000000", tmp_path / "x.png", pixel)
    assert list(tmp_path.glob("*.png")) == []


def test_a_pixel_whose_parts_share_bins_is_refused(transient_copy, transient_bins):
    # Bins of 1 m: the splat reaches 1.5 m, farther than the hidden light is behind the direct one.
    wide = TransientLayout(WIDTH, HEIGHT, 8, 1.0, START_M)
    bins = transient_bins.reshape(HEIGHT, WIDTH, 8, 20).sum(axis=-1)
    with pytest.raises(ExportError, match="may have direct and hidden light in the same bins"):
        pixel_transient(replaced(transient_copy, bins, wide), "000000", (20, 9))


def test_a_scene_that_was_changed_since_it_was_rendered_is_refused(transient_copy, tmp_path):
    file = transient_copy.scene_folder("000000") / "scene.json"
    content = json.loads(file.read_text())
    content["camera"]["location_m"][0] += 0.3
    file.write_text(json.dumps(content))
    for command in (("plot", transient_copy.root, "000000"), ("convert", transient_copy.root, "--to", "tal")):
        message = refusal("night-render", *command, "--out", tmp_path / "plot.png")
        assert f"the files in {file.parent} are not those that were rendered" in message
    with pytest.raises(ExportError, match="not those that were rendered"):
        read_tile(transient_copy, "000000", np.zeros((60, 80, 3), np.uint8))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"start_opl_m": -1e308}, r"lengths of at most 1e\+12 m"),
        ({"bin_width_m": 1e300}, r"must be 1e-09 to 1e\+06 m"),
    ],
)
def test_a_time_axis_of_impossible_length_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(LAYOUT, **changes)
