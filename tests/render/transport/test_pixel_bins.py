"""Pixels store the stretches of the time axis that their light may reach: all of it, and little else."""

import many_light_scenes as corner
import numpy as np
import pytest
from many_light_scenes import LAYOUT, SMALL, ball, box, expose, rough_plastic, square
from odd_corners import OddCorner

from render.transport.passes import transient_pass
from render.transport.passes.pixel_bins import pixel_bins

BLOCKER = square((0.4, -0.2, 1.65), (1, 1, 0), 0.3)  # in sight, black
CASES = {
    "lattice": (OddCorner((ball(),), wall_bsdf=rough_plastic(0.5)), LAYOUT),
    "exact": (OddCorner((box(),)), SMALL),
    "edge of a wall": (OddCorner((ball(),), fov_deg=90), LAYOUT),
    "edge of another thing": (OddCorner((ball(),), blockers=(BLOCKER,)), LAYOUT),
    "no object": (OddCorner(), LAYOUT),
}


def all_bins(exposure):
    return np.concatenate(list(exposure.row_blocks()))


@pytest.fixture(scope="module", params=CASES)
def exposed(request, variant, tmp_path_factory):
    scene, layout = CASES[request.param]
    return expose(scene.load(tmp_path_factory.mktemp("scene")), variant, lights=512, layout=layout)


def test_no_light_lies_outside_the_stretches(exposed, monkeypatch):
    layout = exposed.view.layout
    found = all_bins(exposed)

    def whole(ends, layout):
        count = layout.width * layout.height
        return pixel_bins([(np.zeros(count), np.full(count, layout.bin_count))] * len(ends), layout)

    monkeypatch.setattr(transient_pass, "pixel_bins", whole)
    everywhere = all_bins(exposed)
    assert everywhere.any(axis=2).sum() > 0.5 * layout.width * layout.height
    # A place counts from the stretch instead of the start of the axis: 2^-44 of a bin, far below a float32.
    np.testing.assert_allclose(found, everywhere, rtol=3e-7, atol=1e-9 * everywhere.max())


def test_a_pixel_stores_few_dark_bins(exposed):
    rows = exposed.lit_rows()
    blocks = list(rows.blocks)
    for (_, bins), count in zip(
        rows.stretches.parts(np.concatenate(blocks), exposed.view.layout.bin_count),
        rows.stretches.counts,
        strict=True,
    ):
        lit = bins != 0
        last = count - lit[..., ::-1].argmax(axis=-1)
        span = np.where(lit.any(axis=-1), last - lit.argmax(axis=-1), 0)
        # Lights that face a pixel and are hidden from it, and what rounding removes of weak light.
        assert count < 1.3 * span.max() + 10
    assert rows.stretches.numbers < exposed.view.layout.bin_count / 2


def test_stretches_stay_on_the_time_axis(variant):
    layout = corner.TransientLayout(2, 1, 20, 0.01, 0.0)
    low, high = np.array([-3.2, 14.0]), np.array([1.5, 22.5])
    stretches, (places,) = pixel_bins([(low, high)], layout)
    assert stretches.counts == (9,)
    assert places.first.tolist() == [0, 11]
    dark = np.full(2, np.inf)
    stretches, (places,) = pixel_bins([(dark, -dark)], layout)
    assert stretches.counts == (1,)
    assert places.first.tolist() == [0, 0]
