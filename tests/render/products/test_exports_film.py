"""Films of a rendered transient: what a frame shows, and what cannot be filmed."""

import re
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from exported_scene import BIN_M, BINS, HEIGHT, START_M, WIDTH, footprint_m
from PIL import Image

from itof import TransientLayout, TransientReader, TransientWriter
from render.products.conversion import ExportError
from render.products.movie import MovieOptions, write_movie

SMALL = MovieOptions(min_width=240)  # 10 pixels for each of the transient's


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


def first_shown_bin(transient_bins):
    peak = transient_bins.max(axis=(0, 1))
    return np.flatnonzero(peak > peak.max() * 1e-6)[0] - 1  # a film begins with one dark bin


@pytest.mark.long
def test_a_film_shows_the_wavefront_cross_the_wall_in_the_order_of_its_path_lengths(
    transient_dataset, transient_bins, tmp_path
):
    out = tmp_path / "film.mp4"
    write_movie(transient_dataset.render_folder("000000") / "transient.exr", out, MovieOptions(min_width=470))
    facts, pixels = decoded(out)
    scale = 20  # 470 / 24, rounded up
    assert "h264" in facts
    assert "yuv420p" in facts
    assert pixels.shape[2] == WIDTH * scale
    assert pixels.shape[1] >= HEIGHT * scale
    green = samples(pixels, scale)[..., 1]  # climbs with brightness over the whole colour scale
    shown_m = (
        START_M + (first_shown_bin(transient_bins) + green.argmax(axis=0) + 0.5) * BIN_M
    )  # one bin a frame
    nearest_m, farthest_m = footprint_m(transient_dataset.scene("000000"))
    below = np.arange(HEIGHT) >= 2  # the label
    assert (shown_m > nearest_m - 1.5 * BIN_M)[below].all()  # the splat reaches 1.5 bins to either side
    assert (shown_m < farthest_m + 1.5 * BIN_M)[below].all()


def test_a_film_has_a_frame_for_every_bin_from_the_first_to_the_last_light(
    transient_dataset, transient_bins, tmp_path
):
    with TransientReader(transient_dataset.render_folder("000000") / "transient.exr") as reader:
        write_movie(reader, tmp_path / "film.mp4", SMALL)
    peak = transient_bins.max(axis=(0, 1))
    last = np.flatnonzero(peak > peak.max() * 1e-6)[-1] + 1  # a dark bin at the end too
    assert len(decoded(tmp_path / "film.mp4")[1]) == min(last, BINS - 1) + 1 - first_shown_bin(transient_bins)


def test_the_hidden_return_is_visible_after_the_direct_one(transient_dataset, tmp_path):
    write_movie(transient_dataset.render_folder("000000") / "transient.exr", tmp_path / "film.mp4", SMALL)
    red, green, _ = samples(decoded(tmp_path / "film.mp4")[1], 10)[:, HEIGHT // 2, 2].T  # near: lit early
    direct = green.argmax()
    assert green[direct] > 150
    # The object is some 2.5 m of path farther (docs/science/design.md, Scene): dark for 15 bins of 5 cm,
    # then lit again.
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


def test_a_gif_has_the_same_frames(transient_dataset, tmp_path):
    source = transient_dataset.render_folder("000000") / "transient.exr"
    for name in ("film.gif", "film.mp4"):
        write_movie(source, tmp_path / name, MovieOptions(max_frames=10, min_width=240))
    pixels = decoded(tmp_path / "film.mp4")[1]
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == len(pixels)
        assert gif.size == pixels.shape[2:0:-1]


@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_that_cannot_be_written_leaves_nothing(transient_dataset, tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(ExportError, match=rf"cannot write .*{name}"):
        write_movie(
            transient_dataset.render_folder("000000") / "transient.exr",
            tmp_path / name,
            MovieOptions(max_frames=2),
        )
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


def test_what_ffmpeg_complains_of_is_passed_on(transient_dataset, tmp_path, monkeypatch):
    stub = tmp_path / "ffmpeg"
    stub.write_text("#!/bin/sh\necho no codec here >&2\nexit 1\n")
    stub.chmod(0o755)
    imageio_ffmpeg.get_ffmpeg_exe()  # so that a remembered name would show
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(stub))
    with pytest.raises(ExportError, match="ffmpeg could not encode the movie: no codec here"):
        write_movie(transient_dataset.render_folder("000000") / "transient.exr", tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == [stub]


def test_only_films_and_only_of_light_are_made(transient_dataset, tmp_path):
    with pytest.raises(ExportError, match=r"a movie is an \.mp4 or a \.gif file"):
        write_movie(transient_dataset.render_folder("000000") / "transient.exr", tmp_path / "film.avi")
    with TransientWriter(tmp_path / "dark.exr", TransientLayout(3, 2, 5, 0.01, 0.0), {}) as writer:
        writer.write_rows(np.zeros((2, 3, 5)))
    with pytest.raises(ExportError, match="holds no light"):
        write_movie(tmp_path / "dark.exr", tmp_path / "film.mp4")
