"""Films of depth maps: their time, and depths that can be read from their colours."""

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from itof import DepthMap
from itof.pictures.depth_film import FilmFrame, write_depth_film

NEAR_M, FAR_M = 2.0, 3.0
HEIGHT, WIDTH, TIMES = 6, 10, 32  # pixels of 10 columns become squares of 32


def square(depth_m, column):
    """A tilted square of three pixels a side, which begins at a column."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[2:5, column : column + 3] = True
    tilted_m = depth_m + 0.1 * np.arange(HEIGHT)[:, None] * np.ones(WIDTH)
    depths_m = np.where(mask, tilted_m, 0).astype(np.float32)
    return DepthMap(depths_m, mask, mask.astype(np.complex64), 20e6)


def moving():
    return [(square(2.1 + 0.05 * k, k), square(2.3, 6 - k)) for k in range(5)]


def depth_of(pixels):
    """(H, W) depths of (H, W, 3) colours, metres; NaN where they are grey."""
    grey = np.ptp(pixels.astype(int), axis=-1) == 0
    scale = 255 * colormaps["viridis"](np.arange(256))[:, :3]
    nearest = np.abs(pixels[:, :, None].astype(float) - scale).sum(axis=-1).argmin(axis=-1)
    return np.where(grey, np.nan, NEAR_M + (FAR_M - NEAR_M) * nearest / 255)


def test_the_depths_of_every_frame_can_be_read_from_its_colours_and_its_time_is_that_of_the_rate(tmp_path):
    views = moving()
    frames = [FilmFrame(f"{k} s", {"truth": one, "prediction": two}) for k, (one, two) in enumerate(views)]
    write_depth_film(tmp_path / "film.gif", iter(frames), 4.0, (NEAR_M, FAR_M))
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.info["loop"]) == (5, 0)
        for number, pair in enumerate(views):
            film.seek(number)
            assert film.info["duration"] == 250
            pixels = np.array(film.convert("RGB"))
            top, side = 8 + 2 * 20, WIDTH * TIMES
            for place, view in enumerate(pair):
                left = 8 + place * (side + 8)
                panel = pixels[top : top + HEIGHT * TIMES : TIMES, left : left + side : TIMES]
                shown_m, true_m = depth_of(panel), np.where(view.mask, view.radial_depth_m, np.nan)
                # Half a step of the film's 224 colours over 1 m, and one of the 256 that they are taken from.
                np.testing.assert_allclose(shown_m, true_m, atol=0.5 / 223 + 1 / 255)
    write_depth_film(tmp_path / "again.gif", frames, 4.0, (NEAR_M, FAR_M))
    assert (tmp_path / "again.gif").read_bytes() == (tmp_path / "film.gif").read_bytes()


@pytest.mark.parametrize(("rate_hz", "duration_ms"), [(50, 20), (1000, 20), (0.5, 2000), (1e-3, 600_000)])
def test_a_film_is_as_fast_as_browsers_show(tmp_path, rate_hz, duration_ms):
    frames = [FilmFrame("", {"prediction": square(2.1, k)}) for k in range(2)]
    write_depth_film(tmp_path / "film.gif", frames, rate_hz, (NEAR_M, FAR_M))
    with Image.open(tmp_path / "film.gif") as film:
        assert film.info["duration"] == duration_ms
