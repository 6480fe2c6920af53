"""Light that met the hidden object more than once: against the path tracer, and where there can be none."""

from dataclasses import replace

import numpy as np
import pytest
from many_light_scenes import FREQUENCIES_HZ, Corner, ball, box, expose, measure, path_phasors

from itof import MeasurementMatrix, TransientLayout
from render.options import PathOptions
from render.transport.method import View
from render.transport.path_tracer import PathTracer

LONG = TransientLayout(12, 9, 2400, 0.01, 0.0)  # long enough for five bounces


def niche():
    """A box of half a metre without the face towards the wall: its inside lights itself."""
    mesh = box(angle_rad=0.0)
    mesh.update_faces(mesh.face_normals[:, 0] > -0.5)
    return mesh


def measured(scene, variant, max_bounces, lights=512):
    return measure(scene, variant, lights=lights, layout=LONG, max_bounces=max_bounces)


@pytest.mark.long
@pytest.mark.parametrize("max_bounces", [4, 5])
def test_a_hollow_object_sends_the_light_that_the_path_tracer_finds(variant, tmp_path, max_bounces):
    scene = Corner((niche(),)).load(tmp_path)
    image = measured(scene, variant, max_bounces, lights=2048)
    total = image.hidden.sum(axis=(0, 1))
    paths = path_phasors(scene, variant, seeds=range(12), spp=2048, layout=LONG, max_bounces=max_bounces)
    runs = (paths - image.direct).sum(axis=(1, 2)) / total  # (runs, F)
    for part, expected in ((runs.real, 1), (runs.imag, 0)):
        sigma = part.std(axis=0, ddof=1) / np.sqrt(len(runs))
        # Student's t with 11 degrees of freedom passes 5 once in 2500; the lights' own error is 0.5 %.
        assert np.all(np.abs(part.mean(axis=0) - expected) < 5 * sigma + 0.005)
        # Sharp enough: the tenth that a fourth bounce adds (the next test) is five sigma and more.
        assert np.all(sigma < 0.02)


def test_a_fourth_bounce_adds_a_tenth_and_more_to_a_hollow_object(variant, tmp_path):
    scene = Corner((niche(),)).load(tmp_path)
    three, four, five = (np.abs(measured(scene, variant, n).hidden.sum()) for n in (3, 4, 5))
    assert four > 1.1 * three
    assert five > four


def test_a_convex_object_alone_has_no_fourth_bounce(variant, tmp_path):
    scene = Corner((ball(),)).load(tmp_path)
    three, four = (measured(scene, variant, n).hidden for n in (3, 4))
    # The facets of a convex mesh do not see each other, but rays that leave one may graze its neighbour.
    assert np.abs(four - three).max() < 1e-4 * np.abs(three).max()


def test_transients_of_more_bounces_are_those_of_the_same_lights(variant, tmp_path):
    scene = Corner((niche(),)).load(tmp_path)
    # Smaller pixels than above: what bins add to a pixel's footprint grows with its square.
    layout = replace(LONG, width=24, height=18)
    exposure = expose(scene, variant, lights=256, layout=layout, max_bounces=5)
    exact = exposure.phasors()
    phi = MeasurementMatrix(FREQUENCIES_HZ, layout.bin_count, layout.bin_width_m, splat="quadratic")
    # The promise of docs/science/renderer.md for phasors of the bins: 1 % of the hidden part.
    error = np.linalg.norm(phi.apply_streaming(exposure.row_blocks()) - exact.total, axis=(0, 1))
    assert np.all(error < 0.01 * np.linalg.norm(exact.hidden, axis=(0, 1)))


@pytest.mark.parametrize(("mesh", "has_more"), [(niche(), True), (ball(), False)], ids=["niche", "ball"])
def test_a_fourth_bounce_of_the_path_tracer_continues_the_paths_of_three(variant, tmp_path, mesh, has_more):
    scene = Corner((mesh,)).load(tmp_path)
    tracer = PathTracer(PathOptions(spp=256), variant)
    three, four = (
        np.concatenate(list(tracer.expose(scene, View(LONG, FREQUENCIES_HZ, bounces, 1)).row_blocks()))
        for bounces in (3, 4)
    )
    # Sums of the same paths are the same numbers; a further path can only add to them. Other random numbers
    # would change nearly every bin with direct light, half of them to less.
    assert np.all(four >= three)
    assert np.any(four > three) == has_more
