"""Known formats of cameras, on files of the published layout and on real files where they are there."""

from pathlib import Path

import numpy as np
import pytest
from captures import read_here
from night_commands import night_here, refusal
from scipy.io import savemat

from itof import phasor_of_return, pixel_rays
from itof.capture.capture import ImageShape, capture_of, read_capture
from itof.capture.demodulating import frame_phasors
from itof.capture.sidecar import CaptureError
from itof.capture.sidecar_files import load_sidecar
from itof.files.array_claims import RefusedError
from itof.files.measurement_child import read_arrays

PLACES = [folder / "shared" / "real" for folder in Path(__file__).parents]
REAL = next((place for place in PLACES if place.is_dir()), PLACES[0])
needs_real = pytest.mark.skipif(not REAL.is_dir(), reason="the files of real cameras are not in shared/real")
FOV = "horizontal_fov_deg = 60.0"


def wall(width, height, frequencies_hz):
    """(F, H, W) phasors of a wall that is 1.5 m away on the axis."""
    depth_m = 1.5 / (pixel_rays(width, height, 60.0) @ np.array([0.3, 0.1, 1.0]))
    return np.stack([phasor_of_return(depth_m, f) / depth_m**2 for f in frequencies_hz])


def phasors(files, name, *changes):
    sidecar, folder = load_sidecar(name, changes)
    raw = read_here(files, sidecar, folder)
    return np.moveaxis(next(iter(frame_phasors(raw, sidecar))), -1, 0)


def packed(numbers):
    """Rows of V4L2_PIX_FMT_Y12P of (H, W) numbers of 12 bits."""
    first, second = numbers[:, ::2], numbers[:, 1::2]
    return np.stack([first >> 4, second >> 4, (second & 15) << 4 | first & 15], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("ending", ["raw", "npz"])
def test_arducam(tmp_path, ending):
    z = wall(240, 180, (75e6, 37.5e6))
    files = []
    for place, one in enumerate(z):  # tofcam: the phase that grows with distance is atan2(I3 - I1, I0 - I2)
        four = [one.real, -one.imag, -one.real, one.imag]
        numbers = np.round(600 * np.concatenate(four)).astype(
            np.int16
        )  # (720, 240), within 11 bits with a sign
        files.append(tmp_path / f"{place}.{ending}")
        if ending == "npz":
            np.savez(files[-1], raw=numbers)
        else:
            packed(numbers.astype(np.uint16) & 0xFFF).tofile(files[-1])
    found = phasors(files, "arducam", FOV)
    # Rounding moves each of four numbers by half a unit at most, and the phasor is half of two differences
    np.testing.assert_allclose(found, 600 * z, atol=np.sqrt(2) / 2)


def test_depthai(tmp_path):
    z = wall(64, 48, (80e6, 100e6))
    for name, one in zip(("f80", "f100"), z, strict=True):
        phase = np.mod(np.angle(one), 2 * np.pi).astype("f4")
        np.savez(tmp_path / f"{name}.npz", phase=phase, amplitude=np.abs(one).astype("f4"))
    found = phasors([tmp_path / "f80.npz", tmp_path / "f100.npz"], "depthai")
    np.testing.assert_allclose(found, z, rtol=1e-6)  # phases to 2**-22, half a step of float32 below 8


def test_ti_tintin(tmp_path):
    z = wall(320, 240, (40e6, 70e6))
    size = np.abs(z).mean(axis=0)
    unit = z / np.abs(z)
    planes = np.concatenate([(unit.real + 1) / 2, (unit.imag + 1) / 2, size[None]])
    planes[0, 5, 7] = np.nan
    savemat(tmp_path / "frame.mat", {"im_pair": np.concatenate([planes, 0 * planes], axis=-1)})
    found = phasors([tmp_path / "frame.mat"], "ti-tintin")
    unit[:, 5, 7] = 0
    np.testing.assert_allclose(found, unit * size, atol=1e-14)


def test_flat(tmp_path):
    z = wall(512, 424, (80e6, 16e6, 120e6))
    row = np.arange(424)
    signs = (-1.0) ** np.minimum(row, 423 - row)
    steps_rad = np.array(load_sidecar("flat")[0].steps_rad)
    frames = np.real(z[..., None] * np.exp(-1j * steps_rad)) * signs[:, None, None]  # (F, H, W, 3)
    (tmp_path / "frame").write_bytes(np.round(1e4 * frames).astype("<i4").transpose(1, 2, 0, 3).tobytes())
    found = phasors([tmp_path / "frame"], "flat")
    np.testing.assert_allclose(found, 1e4 * z, atol=1)  # 2/3 of three numbers, each rounded by half a unit


def test_adi_says_that_the_phases_are_lost(tmp_path):
    pixels = np.zeros((512, 512), [("d", "<u2"), ("c", "u1"), ("b", "<u2")])
    pixels["d"] = np.repeat([1000, 1500], 256)
    pixels.tofile(tmp_path / "frame.bin")
    said = refusal("night-eval", "capture", "import", tmp_path / "frame.bin", "--sidecar", "adi-adtf3175",
                   "--out", tmp_path / "out.npz")  # fmt: skip
    assert "one depth image for all frequencies (1.00 to 1.50 m in most pixels)" in said
    assert "which are lost, and with them the hidden light: record raw frames" in said
    assert not (tmp_path / "out.npz").exists()


# Real files


@needs_real
def test_the_phases_of_a_real_wall_follow_the_depths_of_its_own_file():
    file = REAL / "tintin_two_frequencies.mat"
    z = phasors([file], "ti-tintin")
    depth_m = 10 * read_arrays(file, ("im_pair",))[0]["im_pair"][0, :, 320:]
    lit = (np.abs(z[0]) > 0.1) & (depth_m > 0.5) & (depth_m < 3)
    for one, frequency_hz, offset_rad in zip(z, (40e6, 70e6), (-0.1, 0.05), strict=True):
        error = np.angle(one * np.exp(-1j * offset_rad) / phasor_of_return(depth_m, frequency_hz))[lit]
        # Depths have steps of 2 cm, 34 mrad at 40 MHz; a wrong sign gives 1.8 rad (random phases)
        assert np.sqrt(np.mean(error**2)) < 0.15


@needs_real
def test_a_real_wall_beside_the_middle_of_the_image_is_found_by_a_window():
    name = REAL / "tintin_two_frequencies.mat"
    done = night_here("night-eval", "capture", "check", name, "--sidecar", "ti-tintin", "--size", "24x10")
    assert "no wall found" in done.stderr
    window = "window = [65, 2, 230, 92]"
    done = night_here("night-eval", "capture", "check", name, "--sidecar", "ti-tintin", "--size", "24x10",
                      "--set", window)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "the wall is 1.6" in done.stdout  # 1.36 to 1.9 m, says the file


@needs_real
def test_a_real_file_with_nan_has_dead_pixels():
    sidecar, folder = load_sidecar("ti-tintin")
    capture = read_capture([REAL / "tintin_two_frequencies_nan.mat"], sidecar, folder)
    assert capture.facts.dead == pytest.approx(23 / (320 * 240))  # where I70 is NaN, I40 is, too
    assert (capture.phasor == 0).all(axis=-1).sum() == 23


@needs_real
def test_real_phases_that_are_noise_are_refused():
    halves = [f"= (2 * im_pair[{at}:{at + 2}, :, :240] - 1) * im_pair[4, :, :240]" for at in (0, 2)]
    changes = ["frequencies_hz = [45.18e6, 37.65e6]", f'arrays = ["{halves[0]}"]']
    each = [word for line in (*changes, f'imaginary_arrays = ["{halves[1]}"]') for word in ("--set", line)]
    file = REAL / "pmd_type_phases_are_noise.mat"
    said = refusal("night-eval", "capture", "check", file, "--sidecar", "ti-tintin", *each)
    assert "the phases at 45.18, 37.65 MHz are noise" in said


@needs_real
def test_real_depths_and_pickles_are_refused_with_the_reason():
    sidecar, _ = load_sidecar("adi-adtf3175")
    raw = read_here([REAL / "adtf3175_depth_confidence_ab.bin"], sidecar)
    with pytest.raises(CaptureError, match=r"one depth image for all frequencies \(0\.63 to 3\.39 m"):
        capture_of(raw, sidecar)
    with pytest.raises(RefusedError, match=r"pickled Python objects.*save plain arrays: .*numpy\.savez"):
        read_arrays(REAL / "tmf8828_nlos_pickled.npy", ("array",))


@needs_real
def test_real_histograms_become_phasors(tmp_path):
    (tmp_path / "vl53l8.toml").write_text(
        'layout = "histograms"\narrays = ["= reshape(hists, 4, 4, 128)"]\naxes = ["row", "column", "bin"]\n'
        "bin_width_s = 250e-12\nfrequencies_hz = [100e6, 500e6]\nhorizontal_fov_deg = 45.0\n"
    )
    sidecar, folder = load_sidecar(tmp_path / "vl53l8.toml")
    file = REAL / "vl53l8_nlos_histograms.npz"
    z = read_capture([file], sidecar, folder, ImageShape()).phasor
    histograms = read_arrays(file, ("hists",))[0]["hists"]
    turns = np.exp(2j * np.pi * 250e-12 * (np.arange(128) + 0.5)[:, None] * np.array([100e6, 500e6]))
    np.testing.assert_allclose(z, (histograms @ turns).reshape(4, 4, 2), rtol=1e-9)
