"""Light that arrives outside the time axis of a transient is refused, or lost on request."""

import logging
import re

import numpy as np
import pytest
from many_light_scenes import BLACK, FREQUENCIES_HZ, Corner, ball, expose
from night_commands import night_here

from itof import MeasurementMatrix, TransientLayout
from render.farm.inventory import Inventory
from render.options import ManyLightOptions, PathOptions
from render.rendering import Renderer
from render.settings import RenderError, RenderSettings
from render.transport.passes.transient_pass import LostLightError
from scenegen import read_record

WHOLE = TransientLayout(12, 9, 1400, 0.01, 0.0)


@pytest.fixture(scope="module")
def scene(variant, tmp_path_factory):
    return Corner((ball(),)).load(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def whole(scene, variant):
    """(H, W, T) a transient whose axis holds all light."""
    return rows(scene, variant, WHOLE)


def rows(scene, variant, layout, **options):
    return np.concatenate(list(expose(scene, variant, lights=64, layout=layout, **options).row_blocks()))


def filled_bins(transient):
    found = np.flatnonzero(transient.any(axis=(0, 1)))
    return int(found[0]), int(found[-1])


def refused(scene, variant, layout):
    """Lost share and bounds of the arrivals, as the error names them."""
    with pytest.raises(LostLightError) as refusal:
        rows(scene, variant, layout)
    found = re.search(
        r"path length\): (\S+) times (.*)\. Arrivals are between (\S+) m and (\S+) m", str(refusal.value)
    )
    assert found, refusal.value
    return float(found[1]), found[2], float(found[3]), float(found[4])


@pytest.mark.parametrize("with_object", [True, False])
@pytest.mark.parametrize("cut", ["end", "start"])
def test_an_axis_that_loses_light_is_refused_with_its_share_and_the_arrivals(
    scene, whole, variant, tmp_path, cut, with_object
):
    if not with_object:
        scene = Corner().load(tmp_path)
        whole = rows(scene, variant, WHOLE)
    first, last = filled_bins(whole)
    if cut == "end":
        layout = TransientLayout(12, 9, (first + last) // 2, 0.01, 0.0)
        kept = whole[..., : layout.bin_count]
    else:
        layout = TransientLayout(12, 9, 1400, 0.01, (first + 50) * 0.01)
        kept = whole[..., first + 50 :]
    share, what, low_m, high_m = refused(scene, variant, layout)
    energy = whole.sum(dtype=float)
    lost = energy - kept.sum(dtype=float)
    if with_object:
        assert what == "the hidden light"
        with_no_object = rows(Corner().load(tmp_path), variant, WHOLE)
        energy -= with_no_object.sum(dtype=float)
    else:
        assert what == "all light"
    # Two digits; sums of float32 numbers, of which the direct ones are up to 5000 times the hidden ones.
    assert share == pytest.approx(lost / energy, rel=0.06)
    # The bounds hold the light: a return fills three bins.
    assert low_m <= (first + 2) * 0.01
    assert high_m >= (last - 1) * 0.01
    # and they are no more than a meter wider, the size of the object twice
    assert high_m < (last + 1) * 0.01 + 2.5
    assert low_m > first * 0.01 - 1.0


def test_a_black_object_does_not_hide_that_light_is_lost(variant, tmp_path):
    scene = Corner((ball(),), hidden_bsdf=BLACK).load(tmp_path)
    share, what, low_m, high_m = refused(scene, variant, TransientLayout(12, 9, 300, 0.01, 0.0))
    assert 0 < share <= 1
    assert what == "all light"
    assert low_m < 3 < high_m


def test_an_axis_with_the_bounds_of_the_error_holds_all_light(scene, whole, variant):
    *_, low_m, high_m = refused(scene, variant, TransientLayout(12, 9, 300, 0.01, 0.0))
    start_m = low_m - 0.02
    layout = TransientLayout(12, 9, int(np.ceil((high_m + 0.02 - start_m) / 0.01)), 0.01, start_m)
    tight = rows(scene, variant, layout)
    phi = [
        MeasurementMatrix(FREQUENCIES_HZ, axis.bin_count, 0.01, axis.start_opl_m, splat="quadratic")
        for axis in (layout, WHOLE)
    ]
    assert tight.sum(dtype=float) == pytest.approx(whole.sum(dtype=float), rel=1e-6)
    np.testing.assert_allclose(phi[0].apply(tight), phi[1].apply(whole), atol=2e-6 * whole.sum(axis=-1).max())


def test_an_axis_that_ends_with_the_last_light_holds_it(scene, whole, variant):
    first, last = filled_bins(whole)
    layout = TransientLayout(12, 9, last - first + 1, 0.01, first * 0.01)
    # The axis of the interpolated curves starts elsewhere, by float32 rounding of the start.
    tight = rows(scene, variant, layout)
    np.testing.assert_allclose(tight, whole[..., first : last + 1], atol=1e-5 * whole.max())


def test_lost_light_can_be_accepted(scene, whole, variant, caplog):
    layout = TransientLayout(12, 9, 600, 0.01, 0.0)
    from render.transport.many_light import ManyLight
    from render.transport.method import View

    view = View(layout, FREQUENCIES_HZ, 3, 1, accept_lost_light=True)
    with caplog.at_level(logging.WARNING):
        kept = list(ManyLight(ManyLightOptions(lights=64), variant).expose(scene, view).row_blocks())
    # The same float32 terms in another order; a sum of n terms errs by up to n x 6e-8, and n is below 1000.
    np.testing.assert_allclose(np.concatenate(kept), whole[..., :600], rtol=1e-4, atol=1e-7 * whole.max())
    assert len([r for r in caplog.records if "outside the time axis" in r.getMessage()]) == 1


# Commands


@pytest.fixture
def short(make_dataset):
    """A dataset whose time axis ends before the hidden light does."""
    return make_dataset(
        {
            "dataset": {"count": 1, "seed": 3},
            "hidden_object": {"shapes": ["cube"], "composite_fraction": 0},
            "camera": {"width": 24, "height": 18},
            "transient": {"bin_count": 600},
        }
    )


def settings(**changes):
    return RenderSettings(product="both", options=ManyLightOptions(lights=64), device="cpu", **changes)


def test_the_renderer_refuses_lost_light_in_one_sentence_and_leaves_no_file(short, variant):
    with pytest.raises(RenderError, match="--accept lost-light") as refusal:
        Renderer(short, settings()).render("000000")
    message = str(refusal.value)
    assert "\n" not in message
    assert "scene 000000: transient.exr: light arrives outside the time axis of 0 to 6 m" in message
    assert "bin_count" in message
    folder = short.render_folder("000000")
    assert not folder.exists() or not list(folder.iterdir())


@pytest.mark.long
def test_the_renderer_writes_what_is_left_if_that_is_accepted(short, variant, caplog):
    with caplog.at_level(logging.WARNING):
        Renderer(short, settings(accept_lost_light=True)).render("000000")
    assert "outside the time axis" in caplog.text
    assert (short.render_folder("000000") / "transient.exr").is_file()
    # Phasors need no bins.
    Renderer(short, RenderSettings(options=ManyLightOptions(lights=64), device="cpu")).render("000000")


@pytest.mark.long
def test_the_command_has_the_option(short):
    done = night_here("night-render", short.root, "--lights", 64, "--device", "cpu")
    assert done.returncode != 0
    assert "--accept lost-light" in done.stderr + done.stdout
    options = ["--lights", 64, "--device", "cpu", "--again", "failed", "--accept", "lost-light"]
    done = night_here("night-render", short.root, *options)
    assert done.returncode == 0, done.stderr


def test_a_render_that_fails_leaves_the_earlier_one(short, variant):
    itof = RenderSettings(options=ManyLightOptions(lights=64), device="cpu")
    record = Renderer(short, itof).render("000000")
    folder = short.render_folder("000000")
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(RenderError, match="--accept lost-light"):
        Renderer(short, settings()).render("000000")
    assert read_record(folder) == record
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    assert Inventory(short, itof).state("000000") == "done"
    assert Inventory(short, settings()).state("000000") == "missing"


def test_phasors_from_bins_need_memory_for_bins(short, monkeypatch):
    monkeypatch.setattr("render.settings._WORKING_COPIES", 10**9)
    assert RenderSettings(device="cpu").layout(short).bin_count == 600
    with pytest.raises(RenderError, match="or --method many-light"):
        RenderSettings(options=PathOptions(), device="cpu").layout(short)
