"""Raw frames become the phasors that they were made of, whatever their layout, order, sign and unit."""

import h5py
import numpy as np
import pytest
from captures import IMAGES, TAPS, raw_of, read_here, sidecar_of, steps, taps_of, without
from scipy.io import savemat
from wall_measurements import FREQUENCIES_HZ, wall_of_plane

from itof import amplitude, phase, phasor_channels, write_image, z_from_radial
from itof.capture.capture import ImageShape, capture_of
from itof.capture.demodulating import frame_phasors, sensor_pixels
from itof.capture.sidecar_files import load_sidecar
from itof.files.array_claims import RefusedError
from itof.sensor.demodulation import tap_differences
from itof.sensor.settings import SensorSettings

WALL = wall_of_plane()
PHASOR = WALL.direct  # (18, 26, 3), of non-square images
ROUNDING = 1e-13


def phasors(sidecar, **arrays):
    return phasors_of(raw_of(sidecar, **arrays), sidecar)


def phasors_of(raw, sidecar):
    (found,) = frame_phasors(raw, sidecar)
    return found


def assert_phasors(found, expected=PHASOR, tolerance=ROUNDING):
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize("count", [3, 4, 5, 8])
@pytest.mark.parametrize("sign", [1, -1])
def test_differences_of_the_sensor_model_become_its_phasors(tmp_path, count, sign):
    settings = SensorSettings(phase_steps=count)  # sinusoidal, contrast 1
    seen = PHASOR if sign > 0 else PHASOR.conj()
    raw = np.stack([tap_differences(settings, seen[..., f], 20e6) for f in range(3)])  # (F, H, W, S)
    data = without(TAPS, "tap_count") | {"axes": ["frequency", "row", "column", "step"]}
    sidecar = sidecar_of(tmp_path, data, layout="differences", step_count=count, phase_sign=sign)
    assert_phasors(phasors(sidecar, raw=raw))


@pytest.mark.parametrize("count", [3, 4, 5, 8])
@pytest.mark.parametrize(
    "taps_rad", [(0.0, np.pi), (np.pi, 0.0), tuple(steps(3)), tuple(steps(4)[[2, 0, 3, 1]])]
)
def test_taps_in_any_order_become_the_phasors_of_all_their_light(tmp_path, count, taps_rad):
    raw = taps_of(PHASOR, steps(count), taps_rad)
    sidecar = sidecar_of(tmp_path, tap_count=None, taps_rad=[*map(float, taps_rad)], step_count=count)
    assert_phasors(phasors(sidecar, raw=raw))


def test_a_pixel_with_four_taps_needs_one_step(tmp_path):
    raw = taps_of(PHASOR, [0.0], steps(4))
    assert_phasors(phasors(sidecar_of(tmp_path, step_count=None, tap_count=4), raw=raw))


def test_steps_may_be_uneven(tmp_path):
    uneven = [0.1, 1.0, 3.3, 5.0]
    raw = taps_of(PHASOR, uneven, [0.0, np.pi])
    sidecar = sidecar_of(tmp_path, step_count=None, steps_rad=uneven)
    assert_phasors(phasors(sidecar, raw=raw), tolerance=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_axes_may_be_in_any_order(tmp_path, seed):
    raw, axes = taps_of(PHASOR, steps(4), steps(2))[None], TAPS["axes"]
    order = np.random.default_rng(seed).permutation(6)
    sidecar = sidecar_of(tmp_path, axes=[axes[place] for place in order])
    assert_phasors(phasors(sidecar, raw=raw.transpose(order)))


def test_two_axes_in_one_and_several_arrays_along_one(tmp_path):
    raw = taps_of(PHASOR, steps(4), steps(2))  # (H, W, F, S, T)
    flat = raw.reshape(18, 26, 12, 2)
    sidecar = sidecar_of(
        tmp_path, arrays=["a", "b"], axes=["row", "column", "frequency*step"], stacked_along="tap"
    )
    assert_phasors(phasors(sidecar, a=flat[..., 0], b=flat[..., 1]))
    mixed = np.moveaxis(raw, 3, 2).reshape(18, 26, 12, 2)
    sidecar = sidecar_of(tmp_path, axes=["row", "column", "step*frequency", "tap"])
    assert_phasors(phasors(sidecar, raw=mixed))


def test_gains_and_offsets_of_the_taps_change_no_phase(tmp_path):
    rng = np.random.default_rng(1)
    raw = taps_of(PHASOR, steps(4), steps(2))
    gain, offset = 1 + 0.1 * rng.standard_normal((2, 18, 26, 1, 1, 2)), rng.standard_normal((18, 26, 1, 1, 2))
    found = phasors(sidecar_of(tmp_path), raw=raw * gain[0] + offset)
    assert_phasors(found / gain[0][..., 0, 0, :].mean(axis=-1, keepdims=True), tolerance=1e-12)


def test_dark_frames_are_averaged_and_subtracted(tmp_path):
    rng = np.random.default_rng(2)
    offset = rng.standard_normal((1, 18, 26, 3, 4, 2))  # differs from step to step
    dark = offset + np.array([-1.0, 1.0]).reshape(2, 1, 1, 1, 1, 1)
    raw = taps_of(PHASOR, steps(4), steps(2))[None] + offset
    sidecar = sidecar_of(tmp_path, dark_arrays=["dark"])
    assert_phasors(phasors(sidecar, raw=raw, dark=dark), tolerance=1e-12)
    np.savez(tmp_path / "dark.npz", dark=dark)
    for key in ("calibration_file", "dark_file"):  # the second is the name in earlier versions
        sidecar = sidecar_of(tmp_path, dark_arrays=["dark"], **{key: "dark.npz"})
        assert_phasors(phasors_of(raw_of(sidecar, tmp_path, raw=raw), sidecar), tolerance=1e-12)


def test_dark_frames_are_the_same_along_axes_that_they_lack(tmp_path):
    offset = np.random.default_rng(2).standard_normal((18, 26, 4))  # with one step, offsets do not drop out
    raw = taps_of(PHASOR, [0.0], steps(4)) + offset[:, :, None, None]
    sidecar = sidecar_of(
        tmp_path, step_count=None, tap_count=4, dark_arrays=["dark"], dark_axes=["row", "column", "tap"]
    )
    assert_phasors(phasors(sidecar, raw=raw, dark=offset), tolerance=1e-12)


DEPTH_M = np.repeat(WALL.radial_depth_m[..., None], 3, axis=-1)
PHASES = {
    "rad": ({"phase_unit": "rad"}, phase(PHASOR)),
    "deg": ({"phase_unit": "deg"}, np.degrees(phase(PHASOR))),
    "dn": ({"phase_unit": "dn", "phase_period_dn": 4096.0}, phase(PHASOR) / (2 * np.pi) * 4096),
    "falling": ({"phase_sign": -1}, -phase(PHASOR)),
    "m": ({"layout": "amplitude-depth"}, DEPTH_M),
    "mm": ({"layout": "amplitude-depth", "depth_unit": "mm"}, 1000 * DEPTH_M),
    "axis": (
        {"layout": "amplitude-depth", "depth_along": "axis"},
        np.repeat(z_from_radial(WALL.radial_depth_m, 60.0)[..., None], 3, axis=-1),
    ),
}


@pytest.mark.parametrize("unit", PHASES)
def test_images_of_amplitude_and_phase_or_depth_become_phasors(tmp_path, unit):
    changes, values = PHASES[unit]
    data = IMAGES | {"layout": "amplitude-phase", "arrays": ["p"], "amplitude_arrays": ["a"]} | changes
    found = phasors(sidecar_of(tmp_path, data), p=values, a=amplitude(PHASOR))
    assert_phasors(found, tolerance=1e-12)


def test_a_depth_of_0_is_a_pixel_without_a_value(tmp_path):
    data = IMAGES | {"layout": "amplitude-depth", "arrays": ["d"], "amplitude_arrays": ["a"]}
    sidecar = sidecar_of(tmp_path, data)
    holed = DEPTH_M.copy()
    holed[3, 4] = 0
    found = capture_of(raw_of(sidecar, d=holed[None], a=amplitude(PHASOR)[None]), sidecar)
    assert (found.phasor[3, 4] == 0).all()
    assert found.facts.dead == pytest.approx(1 / DEPTH_M[..., 0].size)
    binned = capture_of(raw_of(sidecar, d=holed[None], a=amplitude(PHASOR)[None]), sidecar, ImageShape(2))
    whole = capture_of(raw_of(sidecar, d=DEPTH_M[None], a=amplitude(PHASOR)[None]), sidecar, ImageShape(2))
    # Three pixels of the bin are left, centred at the same place: phases within what the wall bends there.
    assert np.abs(np.angle(binned.phasor[1, 2] / whole.phasor[1, 2])).max() < 2e-3


def test_phasors_may_be_complex_or_two_arrays(tmp_path):
    assert_phasors(phasors(sidecar_of(tmp_path, IMAGES, layout="phasors"), raw=PHASOR))
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors", arrays=["re"], imaginary_arrays=["im"])
    assert_phasors(phasors(sidecar, re=PHASOR.real, im=PHASOR.imag))


def test_complex_arrays_of_matlab_are_read(tmp_path):
    whole = np.round(1000 * PHASOR)  # MATLAB stores whole numbers in fewer bytes
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors")
    for name, values in (("double", whole), ("single", PHASOR.astype(np.complex64))):
        savemat(tmp_path / f"{name}.mat", {"raw": values})
        found = read_here([tmp_path / f"{name}.mat"], sidecar)
        assert found.values.dtype == values.dtype
        assert_phasors(phasors_of(found, sidecar), values)
    turned = sidecar_of(tmp_path, IMAGES, layout="phasors", axes=["frequency", "column", "row"])
    for size in (4, 8):
        parts = np.empty(whole.shape[::-1], [("real", f"f{size}"), ("imag", f"f{size}")])  # as in version 7.3
        parts["real"], parts["imag"] = whole.real.T, whole.imag.T
        with h5py.File(tmp_path / "seven.mat", "w", userblock_size=512) as file:
            file["raw"] = parts
        found = read_here([tmp_path / "seven.mat"], turned)
        assert found.values.dtype == np.dtype(f"c{2 * size}")
        assert_phasors(phasors_of(found, turned), whole)
    with h5py.File(tmp_path / "whole.h5", "w") as file:
        file["raw"] = np.zeros((3, 26, 18), [("real", "i4"), ("imag", "i4")])
    with pytest.raises(RefusedError, match="raw must be numbers, got"):
        read_here([tmp_path / "whole.h5"], turned)


def test_saturation_is_seen_in_both_parts_of_a_phasor(tmp_path):
    sidecar = sidecar_of(
        tmp_path, IMAGES, layout="phasors", arrays=["re"], imaginary_arrays=["im"], saturation_dn=50.0
    )
    re, im = PHASOR.real.copy(), PHASOR.imag.copy()
    re[3, 4, 0], im[5, 6, 1], im[7, 8, 2] = 60, 60, -60
    expected = np.zeros((18, 26), bool)
    expected[[3, 5, 7], [4, 6, 8]] = True
    np.testing.assert_array_equal(sensor_pixels(raw_of(sidecar, re=re, im=im), sidecar).saturated, expected)


def test_channels_of_an_exr_are_arrays(tmp_path):
    write_image(tmp_path / "m.exr", phasor_channels(PHASOR, FREQUENCIES_HZ), {})
    names = [f"itof.{f / 1e6:g}MHz" for f in FREQUENCIES_HZ]
    sidecar = sidecar_of(
        tmp_path,
        IMAGES,
        layout="phasors",
        arrays=[f"{name}.Re" for name in names],
        imaginary_arrays=[f"{name}.Im" for name in names],
        stacked_along="frequency",
        axes=["row", "column"],
    )
    raw = read_here([tmp_path / "m.exr"], sidecar)
    assert_phasors(phasors_of(raw, sidecar), tolerance=1e-7)  # float32


def test_matlab_files_of_both_versions_and_whole_numbers(tmp_path):
    raw = np.round(1000 * taps_of(PHASOR, steps(4), steps(2)))
    expected = phasors(sidecar_of(tmp_path), raw=raw)
    savemat(tmp_path / "five.mat", {"raw": raw, "other": "text"}, do_compression=True)
    savemat(tmp_path / "small.mat", {"raw": np.full((2, 3, 3, 4, 2), 7.0)})
    with h5py.File(tmp_path / "seven.mat", "w", userblock_size=512) as file:
        file["raw"] = raw.transpose()  # as MATLAB writes it
    for name, axes in (("five", TAPS["axes"]), ("seven", TAPS["axes"][::-1])):
        sidecar = sidecar_of(tmp_path, axes=axes)
        assert_phasors(phasors_of(read_here([tmp_path / f"{name}.mat"], sidecar), sidecar), expected)
    assert read_here([tmp_path / "small.mat"], sidecar_of(tmp_path)).values.dtype == np.float64


def test_recordings_of_espros_cameras(tmp_path):
    fov = ["frequencies_hz = [20e6, 50e6, 60e6]", "horizontal_fov_deg = 60"]
    sidecar, _ = load_sidecar("espros", fov)
    files = []
    for place in range(3):
        # DCS whose phase is that of atan2(DCS3 - DCS1, DCS2 - DCS0) + pi, as the toolkit computes it
        phi, size = phase(PHASOR[..., place]) - np.pi, 500 * np.abs(PHASOR[..., place])
        dcs = np.stack([-size * np.cos(phi), -size * np.sin(phi), size * np.cos(phi), size * np.sin(phi)])
        files.append(tmp_path / f"{place}.h5")
        with h5py.File(files[-1], "w") as file:
            file["frames_0"], file["timestamps"] = dcs[None], [0.0]
    assert_phasors(phasors_of(read_here(files, sidecar), sidecar), 500 * PHASOR)


def test_measurements_of_flat(tmp_path):
    sidecar, _ = load_sidecar("flat")
    wall = wall_of_plane(frequencies_hz=sidecar.frequencies_hz)
    rows = np.minimum(np.arange(18), 17 - np.arange(18))
    signs = 1 - 2 * (rows % 2)  # + - + ... from both edges, as in the mask of FLAT
    shifts = [0, 2 * np.pi / 3, -2 * np.pi / 3]
    raw = [
        1000 * (wall.direct[..., f] * np.exp(1j * shift)).real for f in range(3) for shift in shifts
    ]  # cosines of the light's phase, advanced by the shifts
    found = phasors(sidecar, frames=np.stack(raw, axis=-1) * signs[:, None, None])
    assert_phasors(found, 1000 * wall.direct, tolerance=1e-12)


def test_captures_of_the_authors(tmp_path):
    sidecar, _ = load_sidecar("night-authors", ["horizontal_fov_deg = 60.0"])
    files = []
    for place in range(3):
        for name, image in (("amplitude", np.abs(PHASOR[..., place])), ("depth", WALL.radial_depth_m)):
            files.append(tmp_path / f"scene_cube_1m_mod{place}_{name}.mat")
            with h5py.File(files[-1], "w", userblock_size=512) as file:
                file[name] = image.T
    assert_phasors(phasors_of(read_here(files, sidecar), sidecar), tolerance=1e-12)
