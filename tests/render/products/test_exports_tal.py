"""Captures for y-tal: bins, geometry and formats of a rendered transient."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import yaml
from exported_scene import BIN_M, BINS, HEIGHT, START_M, WIDTH, footprint_m
from render_records import record_anew

from itof import TransientLayout, TransientWriter
from render.products.conversion import ExportError
from render.products.tal_export import export_tal
from scenegen import camera_axes, read_recipe, read_record, wall_normal, write_record
from scenegen.scene_folder import folder_digest


@pytest.fixture(scope="module")
def capture(transient_dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("tal") / "new" / "capture.hdf5"
    export_tal(transient_dataset, "000000", out)
    with h5py.File(out) as file:
        yield file


def test_a_capture_holds_every_bin_of_the_transient_with_time_first_and_columns_before_rows(
    capture, transient_bins
):
    assert capture["H"].shape == (BINS, WIDTH, HEIGHT)
    assert capture["H"].dtype == np.float32
    np.testing.assert_array_equal(capture["H"][()].transpose(2, 1, 0), transient_bins)
    # summed in two orders of float64: rounding only
    np.testing.assert_allclose(
        capture["H"][()].sum(0, np.float64).T, transient_bins.sum(-1, np.float64), rtol=1e-12
    )


def test_a_large_capture_is_written_in_blocks_that_do_not_divide_its_height(
    transient_copy, tmp_path, monkeypatch
):
    layout = TransientLayout(40, 19, 300, BIN_M, START_M)  # 19 rows: blocks of 8, 8 and 3
    noise = np.random.default_rng(0).random((19, 40, 300), np.float32)
    with TransientWriter(transient_copy.renders / "000000/transient.exr", layout, {}) as writer:
        writer.write_rows(noise)
    record_anew(transient_copy.render_folder("000000"))
    monkeypatch.setattr("itof.exr.transient._READ_BYTES", 10 * 4 * 40 * 300)
    export_tal(transient_copy, "000000", tmp_path / "x.hdf5")
    with h5py.File(tmp_path / "x.hdf5") as file:
        np.testing.assert_array_equal(file["H"][()], noise.transpose(2, 1, 0))


def test_wall_points_lie_on_the_wall_and_project_back_onto_their_pixels(capture, transient_dataset):
    scene = transient_dataset.scene("000000")
    points = capture["sensor_grid_xyz"][()]
    assert points.dtype == np.float32
    assert points.shape == (WIDTH, HEIGHT, 3)
    normal = wall_normal(scene.relay_wall)
    # float32 coordinates of a few metres are good to 1e-6 m
    assert np.abs((points - scene.relay_wall.location_m) @ normal).max() < 1e-6
    x, y, z = np.moveaxis((points - scene.camera.location_m) @ camera_axes(scene.camera).T, -1, 0)
    half_width = np.tan(np.radians(scene.camera.horizontal_fov_deg) / 2)
    columns = (x / z / half_width + 1) * WIDTH / 2 - 0.5
    rows = (y / z / half_width) * WIDTH / 2 + HEIGHT / 2 - 0.5
    expected = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT), indexing="ij")
    np.testing.assert_allclose([columns, rows], expected, atol=1e-4)  # 1e-6 m of 5 cm pixels, tenfold
    np.testing.assert_allclose(
        capture["sensor_grid_normals"], np.broadcast_to(normal, points.shape), atol=1e-6
    )
    # the projector's axis is the camera's, and it meets the wall between the four middle pixels
    middle = (WIDTH // 2, HEIGHT // 2)
    corners = points[middle[0] - 1 : middle[0] + 1, middle[1] - 1 : middle[1] + 1].reshape(4, 3)
    (laser,) = capture["laser_grid_xyz"][()].reshape(-1, 3)
    assert (corners.min(0) - 1e-6 <= laser).all()
    assert (laser <= corners.max(0) + 1e-6).all()


def test_the_first_return_of_a_pixel_has_the_length_projector_wall_camera(capture, transient_dataset):
    points = capture["sensor_grid_xyz"][()]
    centre_m = sum(np.linalg.norm(points - capture[f"{end}_xyz"][()], axis=-1) for end in ("laser", "sensor"))
    nearest_m, farthest_m = footprint_m(transient_dataset.scene("000000"))
    assert (centre_m > nearest_m.T).all()
    assert (centre_m < farthest_m.T).all()
    delta_t, t_start = capture["delta_t"][()], capture["t_start"][()]
    assert (delta_t, t_start) == (BIN_M, START_M)
    assert capture["t_accounts_first_and_last_bounces"][()]
    first_m = t_start + ((capture["H"][()] > 0).argmax(axis=0) + 0.5) * delta_t
    # A pixel's first light is that of its nearest point; the splat reaches 1.5 bins before it. The renderer
    # takes at least 8 x 8 Gauss nodes in a pixel, of which the first lies 1/50 of a pixel from the side.
    late_m = first_m - nearest_m.T
    # `footprint_m` looks at the corners; the nearest point of a pixel may lie between them.
    assert late_m.min() > -1.6 * BIN_M
    assert (late_m < BIN_M + (farthest_m - nearest_m).T / 16).all()


def test_a_capture_names_formats_and_provenance_as_tal_reads_them(capture, transient_dataset):
    for name, chosen in (
        ("H_format", "T_Sx_Sy"),
        ("sensor_grid_format", "X_Y_3"),
        ("laser_grid_format", "X_Y_3"),
        ("volume_format", "UNKNOWN"),
    ):
        members = h5py.check_enum_dtype(capture[name].dtype)
        assert capture[name].shape == (1,)
        assert capture[name][0] == members[chosen]
    info = yaml.safe_load(capture["scene_info"][()])
    assert info["scene_id"] == "000000"
    assert info["dataset_seed"] == transient_dataset.index.seed
    assert info["frequencies_hz"] == [20e6, 50e6, 60e6]
    assert info["splat"] == "quadratic"
    assert "one point" in info["laser"]
    assert info["attributes"]["recipe"] == read_record(transient_dataset.render_folder("000000")).recipe


def test_a_camera_that_looks_past_the_wall_has_no_capture(transient_copy, tmp_path):
    file = transient_copy.scene_folder("000000") / "scene.json"
    file.write_text(file.read_text().replace("50.0", "5.0"))
    render = transient_copy.render_folder("000000")
    record = read_record(render)
    recipe = json.dumps(read_recipe(record.recipe) | {"scene_sha256": folder_digest(file.parent)})
    write_record(render, replace(record, recipe=recipe))  # as if it had been rendered so
    with pytest.raises(ExportError, match="the camera looks past the plane of the relay wall"):
        export_tal(transient_copy, "000000", tmp_path / "x.hdf5")
    assert not (tmp_path / "x.hdf5").exists()
