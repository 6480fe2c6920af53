"""What is made of a rendered transient: captures for tal, films, phasors at other frequencies."""

import re
import shutil
import subprocess
from dataclasses import replace

import h5py
import imageio_ffmpeg
import numpy as np
import pytest
import yaml
from PIL import Image

from itof import TransientLayout, TransientReader, TransientWriter, pixel_rays, read_image
from render.products.conversion import ExportError, convert_to_itof, shrink_to_itof
from render.products.movie import MovieOptions, write_movie
from render.products.tal_export import export_tal
from render.products.verification import verify_scene
from render.rendering import Renderer
from render.settings import RenderSettings
from render.transport.method import MethodOptions
from scenegen import camera_axes, open_dataset, read_record, wall_normal

WIDTH, HEIGHT = 24, 18
BIN_M, START_M, BINS = 0.05, 1.0, 160  # 1 m to 9 m of optical path: not from 0, which would hide an offset


@pytest.fixture(scope="module")
def dataset(make_dataset, variant):
    """One scene with transients, and one that is not rendered."""
    made = make_dataset(
        {
            "dataset": {"count": 2},
            "camera": {"width": WIDTH, "height": HEIGHT},
            "transient": {"bin_count": BINS, "bin_width_m": BIN_M, "start_opl_m": START_M},
            "hidden_object": {"shapes": ["sphere"], "composite_fraction": 0.0},
        }
    )
    settings = RenderSettings(product="both", options=MethodOptions(lights=1024), device="cpu")
    Renderer(made, settings).render(made.ids()[0])
    return made


@pytest.fixture
def copied(dataset, tmp_path):
    """The dataset again, for tests that delete."""
    return open_dataset(shutil.copytree(dataset.root, tmp_path / "copy"))


@pytest.fixture(scope="module")
def cube(dataset):
    with TransientReader(dataset.render_folder("000000") / "transient.exr") as reader:
        return reader.read_rows(0, HEIGHT)  # (H, W, T)


@pytest.fixture(scope="module")
def capture(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("tal") / "new" / "capture.hdf5"
    export_tal(dataset, "000000", out)
    with h5py.File(out) as file:
        yield file


def wall_distance_m(scene, width, height):
    """(H, W) length from the camera to the relay wall's plane along each pixel's ray."""
    rays = pixel_rays(width, height, scene.camera.horizontal_fov_deg) @ camera_axes(scene.camera)
    normal = wall_normal(scene.relay_wall)
    return (np.array(scene.relay_wall.location_m) - scene.camera.location_m) @ normal / (rays @ normal)


def footprint_m(scene, fine=64):
    """(H, W) shortest and longest way out and back over each pixel's footprint on the wall."""
    length_m = 2 * wall_distance_m(scene, WIDTH * fine, HEIGHT * fine)  # out and back
    parts = length_m.reshape(HEIGHT, fine, WIDTH, fine)
    return parts.min(axis=(1, 3)), parts.max(axis=(1, 3))


# tal


def test_a_capture_holds_every_bin_of_the_transient_with_time_first_and_columns_before_rows(capture, cube):
    assert capture["H"].shape == (BINS, WIDTH, HEIGHT)
    assert capture["H"].dtype == np.float32
    np.testing.assert_array_equal(capture["H"][()].transpose(2, 1, 0), cube)
    # summed in two orders of float64: rounding only
    np.testing.assert_allclose(capture["H"][()].sum(0, np.float64).T, cube.sum(-1, np.float64), rtol=1e-12)


def test_a_large_capture_is_written_in_blocks_that_do_not_divide_its_height(dataset, tmp_path, monkeypatch):
    root = shutil.copytree(dataset.root, tmp_path / "copy")
    layout = TransientLayout(40, 19, 300, BIN_M, START_M)  # 19 rows: blocks of 8, 8 and 3
    noise = np.random.default_rng(0).random((19, 40, 300), np.float32)
    with TransientWriter(root / "renders/000000/transient.exr", layout, {}) as writer:
        writer.write_rows(noise)
    monkeypatch.setattr("itof.exr._READ_BYTES", 10 * 4 * 40 * 300)
    export_tal(open_dataset(root), "000000", tmp_path / "x.hdf5")
    with h5py.File(tmp_path / "x.hdf5") as file:
        np.testing.assert_array_equal(file["H"][()], noise.transpose(2, 1, 0))


def test_wall_points_lie_on_the_wall_and_project_back_onto_their_pixels(capture, dataset):
    scene = dataset.scene("000000")
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


def test_the_first_return_of_a_pixel_has_the_length_projector_wall_camera(capture, dataset):
    points = capture["sensor_grid_xyz"][()]
    centre_m = sum(np.linalg.norm(points - capture[f"{end}_xyz"][()], axis=-1) for end in ("laser", "sensor"))
    nearest_m, farthest_m = footprint_m(dataset.scene("000000"))
    assert (centre_m > nearest_m.T).all()
    assert (centre_m < farthest_m.T).all()
    delta_t, t_start = capture["delta_t"][()], capture["t_start"][()]
    assert (delta_t, t_start) == (BIN_M, START_M)
    assert capture["t_accounts_first_and_last_bounces"][()]
    first_m = t_start + ((capture["H"][()] > 0).argmax(axis=0) + 0.5) * delta_t
    # A pixel's first light is that of its nearest point: the tent reaches one bin before it, and the
    # renderer takes the middle of cells a 16th of a pixel wide (docs/rendering.md).
    late_m = first_m - nearest_m.T
    assert (late_m > -BIN_M).all()
    assert (late_m < BIN_M + (farthest_m - nearest_m).T / 16).all()


def test_a_capture_names_formats_and_provenance_as_tal_reads_them(capture, dataset):
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
    assert info["dataset_seed"] == dataset.index.seed
    assert info["frequencies_hz"] == [20e6, 50e6, 60e6]
    assert info["splat"] == "tent"
    assert "one point" in info["laser"]
    assert info["attributes"]["recipe"] == read_record(dataset.render_folder("000000")).recipe


def test_a_camera_that_looks_past_the_wall_has_no_capture(copied, tmp_path):
    file = copied.scene_folder("000000") / "scene.json"
    file.write_text(file.read_text().replace("50.0", "5.0"))
    with pytest.raises(ExportError, match="the camera looks past the plane of the relay wall"):
        export_tal(copied, "000000", tmp_path / "x.hdf5")
    assert not (tmp_path / "x.hdf5").exists()


# films


def decoded(film):
    """What ffmpeg says of the file, and its frames (N, H, W, 3)."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", film, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    stream = re.search(r"Video: .*?(?P<width>\d{2,})x(?P<height>\d{2,})", done.stderr.decode())
    size = int(stream["height"]), int(stream["width"])
    return stream[0], np.frombuffer(done.stdout, np.uint8).reshape(-1, *size, 3)


def samples(pixels, scale):
    """(N, H, W, 3) the middle of every enlarged pixel, as numbers that can be subtracted."""
    return pixels[:, scale // 2 : HEIGHT * scale : scale, scale // 2 : WIDTH * scale : scale].astype(int)


def first_shown_bin(cube):
    peak = cube.max(axis=(0, 1))
    return np.flatnonzero(peak > peak.max() * 1e-6)[0] - 1  # a film begins with one dark bin


def test_a_film_shows_the_wavefront_cross_the_wall_in_the_order_of_its_path_lengths(dataset, cube, tmp_path):
    out = tmp_path / "film.mp4"
    write_movie(dataset.render_folder("000000") / "transient.exr", out, MovieOptions(min_width=470))
    facts, pixels = decoded(out)
    scale = 20  # 470 / 24, rounded up
    assert "h264" in facts
    assert "yuv420p" in facts
    assert pixels.shape[2] == WIDTH * scale
    assert pixels.shape[1] >= HEIGHT * scale
    green = samples(pixels, scale)[..., 1]  # climbs with brightness over the whole colour scale
    shown_m = START_M + (first_shown_bin(cube) + green.argmax(axis=0) + 0.5) * BIN_M  # one bin a frame
    nearest_m, farthest_m = footprint_m(dataset.scene("000000"))
    below = np.arange(HEIGHT) >= 2  # the label
    assert (shown_m > nearest_m - BIN_M)[below].all()  # the tent reaches one bin to either side
    assert (shown_m < farthest_m + BIN_M)[below].all()


def test_a_film_has_a_frame_for_every_bin_from_the_first_to_the_last_light(dataset, cube, tmp_path):
    with TransientReader(dataset.render_folder("000000") / "transient.exr") as reader:
        write_movie(reader, tmp_path / "film.mp4")
    peak = cube.max(axis=(0, 1))
    last = np.flatnonzero(peak > peak.max() * 1e-6)[-1] + 1  # a dark bin at the end too
    assert len(decoded(tmp_path / "film.mp4")[1]) == min(last, BINS - 1) + 1 - first_shown_bin(cube)


def test_the_hidden_return_is_visible_after_the_direct_one(dataset, tmp_path):
    write_movie(dataset.render_folder("000000") / "transient.exr", tmp_path / "film.mp4")
    red, green, _ = samples(decoded(tmp_path / "film.mp4")[1], 20)[:, HEIGHT // 2, 2].T  # near: lit early
    direct = green.argmax()
    assert green[direct] > 150
    # The object is some 2.5 m of path farther (DESIGN 1): dark for 15 bins of 5 cm at least, then lit again.
    assert red[direct + 3 : direct + 15].max() < 20
    assert red[direct + 15 :].max() > 50


def test_long_films_add_up_bins_and_wide_ones_average_pixels(tmp_path, monkeypatch):
    monkeypatch.setattr("render.products.movie._MOST_PIXELS_WIDE", 3)  # 5 x 3 pixels become 3 x 2
    bright = np.zeros((3, 5, 40), np.float32)
    bright[..., 10] = 1  # one flash everywhere: averages of edge pixels must not be darker
    with TransientWriter(tmp_path / "flash.exr", TransientLayout(5, 3, 40, 0.01, 0.0), {}) as writer:
        writer.write_rows(bright)
    write_movie(tmp_path / "flash.exr", tmp_path / "film.mp4", MovieOptions(max_frames=1, min_width=240))
    _, (frame,) = decoded(tmp_path / "film.mp4")
    assert frame.shape[1] == 240
    picture = frame[40:160].astype(int)  # below the label, of 2 x 80 rows
    assert np.abs(picture - picture[0, 0]).max() < 8  # one colour, within what the codec changes
    assert picture.mean() > 150


def test_a_gif_has_the_same_frames(dataset, tmp_path):
    source = dataset.render_folder("000000") / "transient.exr"
    for name in ("film.gif", "film.mp4"):
        write_movie(source, tmp_path / name, MovieOptions(max_frames=30))
    pixels = decoded(tmp_path / "film.mp4")[1]
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == len(pixels)
        assert gif.size == pixels.shape[2:0:-1]


@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_that_cannot_be_written_leaves_nothing(dataset, tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(ExportError, match=rf"cannot write .*{name}"):
        write_movie(
            dataset.render_folder("000000") / "transient.exr", tmp_path / name, MovieOptions(max_frames=2)
        )
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


def test_what_ffmpeg_complains_of_is_passed_on(dataset, tmp_path, monkeypatch):
    stub = tmp_path / "ffmpeg"
    stub.write_text("#!/bin/sh\necho no codec here >&2\nexit 1\n")
    stub.chmod(0o755)
    imageio_ffmpeg.get_ffmpeg_exe()  # so that a remembered name would show
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(stub))
    with pytest.raises(ExportError, match="ffmpeg could not encode the film: no codec here"):
        write_movie(dataset.render_folder("000000") / "transient.exr", tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == [stub]


def test_only_films_and_only_of_light_are_made(dataset, tmp_path):
    with pytest.raises(ExportError, match=r"a film is an \.mp4 or a \.gif file"):
        write_movie(dataset.render_folder("000000") / "transient.exr", tmp_path / "film.avi")
    with TransientWriter(tmp_path / "dark.exr", TransientLayout(3, 2, 5, 0.01, 0.0), {}) as writer:
        writer.write_rows(np.zeros((2, 3, 5)))
    with pytest.raises(ExportError, match="holds no light"):
        write_movie(tmp_path / "dark.exr", tmp_path / "film.mp4")


# phasors


def test_phasors_from_bins_are_the_rendered_ones(dataset, tmp_path):
    out = convert_to_itof(dataset, "000000", tmp_path / "new")
    assert out == tmp_path / "new" / "000000_itof.exr"
    rendered = read_image(dataset.render_folder("000000") / "itof.exr")
    made = read_image(out)
    (z, found_hz), (exact, rendered_hz) = made.phasors(), rendered.phasors()
    assert found_hz == rendered_hz
    # docs/rendering.md: 1 % of the hidden part at bins of 1 cm. The direct return's 5 cm bins are summed with
    # the tent divided out, exact for light spread over bins; a pixel's edges are not, in (kw)^2 / 12 of it.
    hidden = np.linalg.norm(rendered.phasors("hidden")[0])
    direct = np.linalg.norm(rendered.phasors("direct")[0])
    assert np.linalg.norm(z - exact) < 0.01 * hidden + (2 * np.pi * 60e6 / 3e8 * BIN_M) ** 2 / 12 * direct
    assert made.attributes["scene_id"] == "000000"
    assert made.attributes["phasors_from"] == "bins of transient.exr"
    assert "hidden_error" in rendered.attributes
    assert "hidden_error" not in made.attributes


def test_phasors_can_be_had_at_any_frequency_that_bins_resolve(dataset, cube, tmp_path):
    out = convert_to_itof(dataset, "000000", tmp_path, [62.5e6, 33e6, 33e6])
    z, found_hz = read_image(out).phasors()
    assert found_hz == (33e6, 62.5e6)
    tau_s = (START_M + (np.arange(BINS) + 0.5) * BIN_M) / 299_792_458
    for index, frequency_hz in enumerate(found_hz):
        tent = np.sinc(frequency_hz * BIN_M / 299_792_458) ** 2
        expected = cube.astype(float) @ np.exp(2j * np.pi * frequency_hz * tau_s) / tent
        np.testing.assert_allclose(z[..., index], expected, rtol=1e-6)  # stored as float32


def test_frequencies_that_bins_cannot_resolve_are_refused(dataset, tmp_path):
    with pytest.raises(ExportError, match=r"scene 000000: bins of 0\.05 m cannot resolve 3000 MHz"):
        convert_to_itof(dataset, "000000", tmp_path, [20e6, 3e9])
    assert list(tmp_path.iterdir()) == []


def test_a_scene_shrinks_to_its_phasors_and_stays_a_whole_render(copied):
    folder = copied.render_folder("000000")
    before, images = read_record(folder), (folder / "itof.exr").read_bytes()
    size = sum((folder / name).stat().st_size for name in ("transient.exr", "mirrored_transient.exr"))
    assert shrink_to_itof(copied, "000000") == size
    assert {f.name for f in folder.iterdir()} == {"itof.exr", "mirrored.exr", "render.json"}
    assert (folder / "itof.exr").read_bytes() == images
    kept = {name: before.files[name] for name in ("itof.exr", "mirrored.exr")}
    assert read_record(folder) == replace(before, files=kept)
    assert verify_scene(copied, "000000") == []
    assert shrink_to_itof(copied, "000000") == 0


def test_transients_stay_where_the_phasors_are_not_whole(copied):
    folder = copied.render_folder("000000")
    (folder / "itof.exr").write_bytes((folder / "itof.exr").read_bytes()[:-100])
    with pytest.raises(ExportError, match=r"itof\.exr is missing or not what was rendered"):
        shrink_to_itof(copied, "000000")
    assert (folder / "transient.exr").is_file()
    assert "transient.exr" in read_record(folder).files


def test_what_an_interrupted_shrinking_left_is_deleted_by_the_next(copied):
    folder = copied.render_folder("000000")
    kept = (folder / "transient.exr").read_bytes()
    shrink_to_itof(copied, "000000")
    (folder / "transient.exr").write_bytes(kept)  # the record was written, the file not yet deleted
    assert shrink_to_itof(copied, "000000") == len(kept)
    assert not (folder / "transient.exr").exists()


# all of them


def test_scenes_without_transients_are_refused_in_one_sentence(copied, tmp_path):
    shrink_to_itof(copied, "000000")
    for scene in ("000000", "000001"):
        for export in (
            lambda scene=scene: export_tal(copied, scene, tmp_path / "x.hdf5"),
            lambda scene=scene: convert_to_itof(copied, scene, tmp_path),
        ):
            with pytest.raises(ExportError, match="render it with night-render --product transient or both"):
                export()
    with pytest.raises(ExportError, match="is not rendered"):
        shrink_to_itof(copied, "000001")


def test_a_capture_that_cannot_be_written_is_refused_in_one_sentence(dataset, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ExportError, match=r"cannot write .*x\.hdf5"):
        export_tal(dataset, "000000", tmp_path / "file" / "x.hdf5")
    with pytest.raises(ExportError, match=r"cannot write .*_itof\.exr"):
        convert_to_itof(dataset, "000000", tmp_path / "file")
