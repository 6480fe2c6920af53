"""Properties of any corner: finite, linear in the light, symmetric, or refused with one sentence.

Hypothesis draws the same examples in every run (`derandomize`).
"""

import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st
from many_light_scenes import CAMERA_LOCATION_M, DIFFUSE, ball, box, expose, relative, rough_plastic
from odd_corners import OddCorner

from disk import NightError
from itof import SPEED_OF_LIGHT, MeasurementMatrix, TransientLayout, splat_residue
from render.transport.passes.transient_pass import LostLightError

FLIP = trimesh.transformations.reflection_matrix(CAMERA_LOCATION_M, [0, 0, 1])


def metres(low, high):
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)  # DrJit may flush these to 0


@st.composite
def hidden_meshes(draw):
    """One or two meshes behind the corner, some of them thin, some inside each other."""
    meshes = []
    for _ in range(draw(st.integers(1, 2))):
        centre = np.array([draw(metres(0.9, 1.6)), draw(metres(0.5, 1.3)), draw(metres(1.2, 2.1))])
        kind = draw(st.sampled_from(["ball", "box", "foil", "rod", "cone"]))
        size = draw(metres(0.1, 0.4))
        if kind == "ball":
            mesh = ball(2, size / 2, centre)
        elif kind == "cone":
            mesh = trimesh.creation.cone(size / 2, size, sections=9).apply_translation(centre)
        else:
            thin = draw(metres(0.0005, 0.01))
            extents = {"box": (size, 0.7 * size, size), "foil": (thin, size, size), "rod": (thin, thin, size)}
            mesh = box(extents[kind], centre, draw(metres(0, 6)))
        meshes.append(mesh)
    return tuple(meshes)


@st.composite
def corners(draw):
    """A corner, its layout and its modulation frequencies."""
    size = draw(st.sampled_from([(8, 6), (6, 8), (12, 5), (5, 9), (7, 7), (16, 9)]))
    roughness = draw(st.one_of(st.none(), metres(0.05, 1.0)))
    corner = OddCorner(
        draw(hidden_meshes()),
        wall_bsdf=DIFFUSE if roughness is None else rough_plastic(roughness),
        fov_deg=draw(metres(20, 100)),
        size=size,
        wall_half_m=draw(st.sampled_from([0.3, 1.0, 3.0, 20.0])),
        has_middle_wall=draw(st.booleans()),
    )
    frequencies_hz = tuple(draw(st.lists(metres(5e6, 400e6), min_size=1, max_size=3, unique=True)))
    width_m = draw(st.sampled_from([0.005, 0.01, 0.05, 0.2]))
    layout = TransientLayout(*size, draw(st.sampled_from([200, 1200, 3000])), width_m, 0.0)
    return corner, layout, frequencies_hz


def exposed(corner, variant, layout, frequencies_hz, **options):
    with tempfile.TemporaryDirectory() as folder:
        scene = corner.load(Path(folder))
    return expose(scene, variant, lights=64, layout=layout, frequencies_hz=frequencies_hz, **options)


def check_sentence(refusal):
    text = str(refusal)
    assert "\n" not in text
    assert 20 < len(text) < 400
    assert "nan" not in text.lower().split()


def check(drawn, variant):
    """The properties of one example."""
    corner, layout, frequencies_hz = drawn
    try:
        exposure = exposed(corner, variant, layout, frequencies_hz)
    except NightError as refusal:
        check_sentence(refusal)
        note(f"refused: {refusal}")
        return
    image = exposure.phasors()
    for part in (image.total, image.direct, image.hidden):
        assert part.shape == (layout.height, layout.width, len(frequencies_hz))
        assert np.isfinite(part).all()
    assert np.isfinite(image.error)
    np.testing.assert_array_equal(image.total, image.direct + image.hidden)
    double = exposed(corner.but(emitter_scale=2.0), variant, layout, frequencies_hz).phasors()
    for name in ("direct", "hidden"):
        one = getattr(image, name)
        # A power of two changes no mantissa; threads may add in another order.
        np.testing.assert_allclose(getattr(double, name), 2 * one, rtol=1e-5, atol=1e-5 * np.abs(one).max())
    check_flip(corner, image, variant, layout, frequencies_hz)
    alpha = corner.wall_bsdf["nested"].get("alpha", 1.0)
    check_transient(exposure, image, layout, frequencies_hz, alpha)


def check_flip(corner, image, variant, layout, frequencies_hz):
    """The direct return is upside down, as is the hidden part within the errors of both."""
    hidden = tuple(mesh.copy().apply_transform(FLIP) for mesh in corner.hidden)
    flipped = exposed(corner.but(hidden=hidden), variant, layout, frequencies_hz).phasors()
    bright = np.abs(image.direct).max()
    # An edge of the wall through a pixel is known to 1e-5 of the pixel, and rays to float32.
    np.testing.assert_allclose(flipped.direct[::-1], image.direct, atol=5e-5 * bright)
    allowed = np.hypot(image.error, flipped.error)
    if np.abs(image.hidden).any() and allowed < 0.5:
        # The bounds hold in 95 of 100 cases, and they are above twice the error on average.
        assert np.all(relative(flipped.hidden[::-1], image.hidden) < 2 * allowed)


def check_transient(exposure, image, layout, frequencies_hz, alpha):
    """The bins hold the steady light and no NaN, or the refusal says what they lose."""
    try:
        transient = np.concatenate(list(exposure.row_blocks()))
    except LostLightError as refusal:
        check_sentence(refusal)
        return
    assert np.isfinite(transient).all()
    assert transient.min() >= 0
    if 2 * max(frequencies_hz) * layout.bin_width_m > 2.9e8:
        return  # the bins cannot carry the frequency
    if alpha < 0.3:
        return  # a lobe much narrower than these pixels: the direct return is known to 4e-5 of the light
    phi = MeasurementMatrix(
        frequencies_hz, layout.bin_count, layout.bin_width_m, layout.start_opl_m, splat="quadratic"
    )
    off = np.abs(phi.apply(transient) - image.total).sum(axis=(0, 1))
    light = transient.sum(dtype=float)
    hidden = np.abs(image.hidden).sum(axis=(0, 1))
    residue = splat_residue(np.array(frequencies_hz), layout.bin_width_m, "quadratic")
    # What bins cannot carry, and rounding of float32 (docs/science/renderer.md); hidden light in wide pixels.
    turns = 2 * np.pi * np.array(frequencies_hz) * layout.bin_count * layout.bin_width_m / SPEED_OF_LIGHT
    assert np.all(off <= (residue + 1e-6 + 6e-8 * turns) * 2 * light + 0.1 * hidden)


@st.composite
def presets(draw):
    """A preset of one small scene, mostly with the paper's walls, which end 4 m above the floor."""
    wide = draw(st.booleans())
    return {
        "dataset": {"count": 1, "seed": draw(st.integers(0, 1000))},
        "hidden_object": {"composite_fraction": draw(st.sampled_from([0.0, 1.0]))},
        "relay_wall": {
            "material": draw(st.sampled_from(["rough", "diffuse"])),
            "roughness": [draw(metres(0.05, 1.0))],
            "size_m": [4.0, draw(st.sampled_from([2.0, 8.0]))],
        },
        "camera": {
            "width": 12 if wide else 9,
            "height": 9 if wide else 12,
            "horizontal_fov_deg": draw(metres(20, 100)),
        },
        "transient": {"bin_count": draw(st.sampled_from([700, 2000])), "bin_width_m": 0.01},
        "itof": {"frequencies_hz": sorted({draw(metres(5e6, 20e6)), draw(metres(20e6, 200e6))})},
    }


def check_preset(preset, make_dataset, variant):
    """Written whole with finite pixels, or refused with a sentence and without any file."""
    from itof import read_image
    from render.options import ManyLightOptions
    from render.rendering import Renderer
    from render.settings import RenderSettings

    try:
        dataset = make_dataset(preset)
    except NightError as refusal:
        check_sentence(refusal)
        return
    options = ManyLightOptions(lights=64)
    try:
        Renderer(dataset, RenderSettings("both", options, device="cpu")).render("000000")
    except NightError as refusal:
        note(f"refused: {refusal}")
        check_sentence(refusal)
        folder = dataset.render_folder("000000")
        assert not folder.exists() or not list(folder.iterdir())
        return
    for name in ("itof.exr", "mirrored.exr"):
        channels = read_image(dataset.render_folder("000000") / name).channels
        assert name != "itof.exr" or all(np.isfinite(values).all() for values in channels.values())


STEADY = settings(
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[
        HealthCheck.function_scoped_fixture,
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
    ],
)


@pytest.mark.long
@settings(STEADY, max_examples=15)
@given(drawn=corners())
def test_any_corner_is_rendered_or_refused(drawn, variant):
    check(drawn, variant)


@pytest.mark.thorough
@settings(STEADY, max_examples=120)
@given(drawn=corners())
def test_a_hundred_and_twenty_corners_are_rendered_or_refused(drawn, variant):
    check(drawn, variant)


@pytest.mark.long
@settings(STEADY, max_examples=6)
@given(preset=presets())
def test_any_preset_is_rendered_or_refused(preset, make_dataset, variant):
    check_preset(preset, make_dataset, variant)


@pytest.mark.thorough
@settings(STEADY, max_examples=30)
@given(preset=presets())
def test_thirty_presets_are_rendered_or_refused(preset, make_dataset, variant):
    check_preset(preset, make_dataset, variant)
