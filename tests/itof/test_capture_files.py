"""Files without a format of their own, pictures and structures: each number is read as it was written."""

import struct
import subprocess
import zlib

import h5py
import numpy as np
import pytest
from captures import IMAGES, TAPS, read_here, sidecar_of, steps, taps_of, write_sidecar
from imageio_ffmpeg import get_ffmpeg_exe
from night_commands import refusal
from PIL import Image
from scipy.io import savemat
from wall_measurements import wall_of_plane

from itof.binary_fields import BinaryLayout
from itof.capture.demodulating import frame_phasors
from itof.capture.sidecar import CaptureError
from itof.files.array_claims import RefusedError
from itof.files.measurement_child import read_arrays

PHASOR = wall_of_plane().direct  # (18, 26, 3)
RNG = np.random.default_rng(0)
RAW = RNG.integers(0, 4096, (2, 18, 26)).astype(np.uint16)


def binary(path, *fields, shape=(), header=0):
    return read_arrays(
        path, tuple(field.split()[0] for field in fields), BinaryLayout(fields, shape, header)
    )[0]


def test_interleaved_fields_of_any_type_come_apart(tmp_path):
    record = np.dtype([("d", "<u2"), ("c", "u1"), ("b", ">i4"), ("f", "<f8")])
    assert record.itemsize == 15
    pixels = np.zeros((2, 6, 8), record)
    for name in record.names:
        pixels[name] = RNG.integers(0, 100, (2, 6, 8))
    path = tmp_path / "frames.bin"
    path.write_bytes(b"header!" + pixels.tobytes())
    found = binary(path, "d <u2", "c u1", "b >i4", "f f8", shape=(6, 8), header=7)
    for name in record.names:
        np.testing.assert_array_equal(found[name], pixels[name])


def test_rows_with_padding_and_packed_numbers_are_read_by_their_stride(tmp_path):
    # V4L2_PIX_FMT_Y12P of the Linux kernel: high bytes of two numbers, then their low halves, the first lower
    first, second = RAW[..., ::2], RAW[..., 1::2]
    packed = np.stack([first >> 4, second >> 4, (second & 15) << 4 | first & 15], axis=-1).astype(np.uint8)
    rows = packed.reshape(2, 18, 39)
    path = tmp_path / "frames"
    np.concatenate([rows, np.full((2, 18, 9), 255, np.uint8)], axis=-1).tofile(path)
    np.testing.assert_array_equal(binary(path, "raw u12 18x26 stride 48")["raw"], RAW)
    (tmp_path / "one").write_bytes(bytes([0xAB, 0xCD, 0x21]))
    assert binary(tmp_path / "one", "raw u12 2")["raw"].tolist() == [[0xAB1, 0xCD2]]


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("raw u3 4x4", "is no field like"),
        ("raw", "is no field like"),
        ("raw u2 4x4 stride 7", "a row has 8 bytes"),
        ("raw u2 0x4", "sides are above 0"),
        ("raw u12 4x3", "rows of u12 are pairs"),
        ("raw O 4x4", "is no field like"),
    ],
)
def test_a_field_that_cannot_be_is_refused(tmp_path, field, words):
    with pytest.raises(CaptureError, match=words):
        sidecar_of(tmp_path, binary={"fields": [field]})


@pytest.mark.parametrize(
    ("fields", "shape", "header"),
    [
        (["raw u2 18x26"], (), 1),
        (["raw u2 18x26"], (), 2**40),
        (["raw u2 999999x999999x999999"], (), 0),
        (["raw u1"], (2**20, 2**20, 2**20), 0),
        (["raw u2 18x26 stride 999999999"], (), 0),
    ],
)
def test_a_file_that_does_not_end_with_a_frame_is_refused(tmp_path, fields, shape, header):
    RAW.tofile(tmp_path / "frames.bin")
    with pytest.raises(
        RefusedError, match=r"are no whole number of frames of .* bytes: correct the table binary"
    ):
        binary(tmp_path / "frames.bin", *fields, shape=shape, header=header)


def save_png(path):
    Image.fromarray(RAW[0]).save(path)


def save_tiff(path):
    pages = [Image.fromarray(page) for page in RAW]
    pages[0].save(path, save_all=True, append_images=pages[1:])


def save_pgm(path):
    path.write_bytes(b"P5 # by a camera\n26 18\n4095\n" + RAW[0].astype(">u2").tobytes())


FILES = {
    "png": (save_png, RAW[0]),
    "tiff": (save_tiff, RAW),
    "pgm": (save_pgm, RAW[0]),
    "npy": (lambda path: np.save(path, RAW), RAW),
}


@pytest.mark.parametrize("ending", FILES)
def test_pictures_and_bare_arrays_hold_the_numbers_that_were_written(tmp_path, ending):
    write, expected = FILES[ending]
    write(path := tmp_path / f"frames.{ending}")
    np.testing.assert_array_equal(read_arrays(path, ("array",))[0]["array"], expected)


def huge_png(path):
    """A picture whose header claims 16 GiB."""
    part = b"IHDR" + struct.pack(">IIBBBBB", 2**17, 2**16, 16, 0, 0, 0, 0)
    head = struct.pack(">I", 13) + part + struct.pack(">I", zlib.crc32(part))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + struct.pack(">I", 10) + b"IDAT" + bytes(14))


HOSTILE = {
    ("grey ones are read: save one grey channel", "png"): lambda path: Image.new("RGB", (4, 4)).save(path),
    ("cannot be read", "png"): huge_png,
    ("is damaged or no PNG or TIFF", "tiff"): lambda path: path.write_bytes(b"GIF89a"),
    ("is damaged or no PNG or TIFF", "tif"): lambda path: save_pgm(path),
    ("no binary PGM file", "pgm"): lambda path: path.write_bytes(b"P5 99999 99999 65535\n" + bytes(99)),
    ("no binary PGM", "pgm"): lambda path: path.write_bytes(b"P2 2 2 9\n1 2 3 4"),
    ("it holds pickled Python objects", "npy"): lambda path: np.save(path, np.array({"raw": 1})),
    ("is followed by other data", "npy"): lambda path: path.write_bytes(npy(RAW) + b"x"),
    ("ends too early", "npy"): lambda path: path.write_bytes(npy(RAW)[:-1]),
}


def npy(values):
    from io import BytesIO

    np.save(stream := BytesIO(), values)
    return stream.getvalue()


@pytest.mark.parametrize(("words", "ending"), HOSTILE)
def test_pictures_and_bare_arrays_that_are_damaged_or_made_to_do_harm_are_refused(tmp_path, words, ending):
    path = tmp_path / f"frames.{ending}"
    HOSTILE[words, ending](path)
    with pytest.raises(RefusedError, match=words) as refused:
        read_arrays(path, ("array",))
    assert str(path) in str(refused.value)


def write_mkv(path, *streams):
    """Streams of 16 bits, or of 8, without loss."""
    command = [get_ffmpeg_exe(), "-y", "-v", "error"]
    for place, values in enumerate(streams):
        values.tofile(part := path.with_suffix(f".{place}"))
        kind = "gray16le" if values.dtype.itemsize == 2 else "gray"
        command += ["-f", "rawvideo", "-pix_fmt", kind, "-s", "26x18", "-r", "7", "-i", part]
    maps = [word for place in range(len(streams)) for word in ("-map", str(place))]
    subprocess.run([*command, *maps, "-c:v", "ffv1", path], check=True)


def test_streams_of_a_video_hold_the_numbers_that_were_written(tmp_path):
    path = tmp_path / "frames.mkv"
    write_mkv(path, RAW.astype(np.uint8), RAW[::-1].copy())
    found, names = read_arrays(path, ("stream1",))
    np.testing.assert_array_equal(found["stream1"], RAW[::-1])
    assert names == ["stream0", "stream1"]
    with pytest.raises(RefusedError, match="stream0 has numbers of the kind gray, and only grey"):
        read_arrays(path, ("stream0",))
    whole = path.read_bytes()
    for damaged in (whole[:300], whole[: -len(whole) // 4], whole[:-200] + bytes(100) + whole[-100:]):
        path.write_bytes(damaged)
        with pytest.raises(RefusedError, match=r"frames\.mkv"):
            read_arrays(path, ("stream1",))


@pytest.mark.parametrize("text", ["ffconcat version 1.0\nfile secret.mkv\n", "#EXTM3U\nsecret.mkv\n", ""])
def test_a_video_leads_to_no_other_file(tmp_path, text):
    write_mkv(tmp_path / "secret.mkv", RAW)
    (tmp_path / "frames.mkv").write_text(text)
    with pytest.raises(RefusedError, match="damaged or no MKV file with video"):
        read_arrays(tmp_path / "frames.mkv", ("stream0",))


def test_a_picture_of_8_bits_is_too_coarse(tmp_path):
    Image.fromarray(RAW[0].astype(np.uint8)).save(tmp_path / "frames.png")
    with pytest.raises(CaptureError, match="8-bit numbers are too coarse"):
        read_here([tmp_path / "frames.png"], sidecar_of(tmp_path, arrays=["= 2 * array"]))


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_fields_of_structures_are_read_by_their_names(tmp_path, version):
    path = tmp_path / "frames.mat"
    if version == "5":
        savemat(path, {"camera": {"frames": {"raw": RAW}, "text": "x", "many": np.array([1.0])}})
    else:
        with h5py.File(path, "w") as file:
            file["camera/frames/raw"] = RAW
    found, names = read_arrays(path, ("camera.frames.raw", "camera.none"))
    np.testing.assert_array_equal(found["camera.frames.raw"], RAW)
    assert set(found) == {"camera.frames.raw"}
    assert version == "7.3" or "camera.frames" in names


def test_a_field_that_is_no_numbers_or_one_of_many_structures_is_refused(tmp_path):
    savemat(path := tmp_path / "frames.mat", {"s": {"text": "x"}, "m": np.zeros(2, [("a", object)])})
    with pytest.raises(RefusedError, match=r"s\.text is no array of numbers"):
        read_arrays(path, ("s.text",))
    with pytest.raises(RefusedError, match=r"m has 2 structures, whose fields are not read"):
        read_arrays(path, ("m.a",))


def test_files_of_single_steps_make_a_capture(tmp_path):
    raw = taps_of(PHASOR, steps(4), [0.0])[..., 0]  # (H, W, F, S)
    files = []
    for frequency in range(3):
        for step in range(4):
            for frame in range(2):
                files.append(tmp_path / f"{frequency}{step}{frame}.npy")
                np.save(files[-1], raw[:, :, frequency, step])
    sidecar = sidecar_of(
        tmp_path,
        arrays=["array"],
        axes=["row", "column"],
        files="steps",
        layout="differences",
        tap_count=None,
    )
    found = list(frame_phasors(read_here(files, sidecar), sidecar))
    np.testing.assert_allclose(found, [PHASOR, PHASOR], atol=1e-12)
    with pytest.raises(CaptureError, match=r"23 files were given, .* 3 frequencies and 4 steps"):
        read_here(files[1:], sidecar)


def test_phase_offsets_of_pixels_are_taken_out(tmp_path):
    zeros = RNG.uniform(-3, 3, PHASOR.shape)
    z = PHASOR * np.exp(1j * (zeros + 0.5))
    np.savez(tmp_path / "frames.npz", raw=z[None])
    np.savez(tmp_path / "tables.npz", table=np.degrees(zeros))
    changes = {"layout": "phasors", "phase_offsets_rad": [0.5] * 3, "calibration_file": "tables.npz"}
    whole = sidecar_of(tmp_path, IMAGES, **changes, phase_offset_arrays=["= table * pi / 180"])
    each = [f"= table[:, :, {place}] * pi / 180" for place in range(3)]
    for sidecar in (whole, sidecar_of(tmp_path, IMAGES, **changes, phase_offset_arrays=each)):
        raw = read_here([tmp_path / "frames.npz"], sidecar, tmp_path)
        np.testing.assert_allclose(next(iter(frame_phasors(raw, sidecar))), PHASOR, atol=1e-12)
    wrong = sidecar_of(tmp_path, IMAGES, **changes, phase_offset_arrays=["= table[:-1]"])
    with pytest.raises(CaptureError, match=r"phase offsets of the shape \(3, 17, 26\) do not fit frames"):
        read_here([tmp_path / "frames.npz"], wrong, tmp_path)


def test_histograms_become_the_phasors_of_their_bins(tmp_path):
    counts = RNG.poisson(5.0, (4, 6, 100)).astype(float)
    np.savez(tmp_path / "frames.npz", counts=counts.reshape(24, 100))
    sidecar = sidecar_of(
        tmp_path,
        {key: TAPS[key] for key in ("horizontal_fov_deg", "frequencies_hz")},
        layout="histograms",
        arrays=["= reshape(counts, 4, 6, 100)"],
        axes=["row", "column", "bin"],
        bin_width_s=250e-12,
    )
    found = next(iter(frame_phasors(read_here([tmp_path / "frames.npz"], sidecar), sidecar)))
    times_s = (np.arange(100) + 0.5) * 250e-12
    expected = counts @ np.exp(2j * np.pi * times_s[:, None] * np.array(TAPS["frequencies_hz"]))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    with pytest.raises(CaptureError, match="the axis bin and bin_width_s go together"):
        sidecar_of(tmp_path, IMAGES, layout="phasors", bin_width_s=1e-9)
    axes = ["row", "column", "frequency", "bin"]
    with pytest.raises(CaptureError, match="the layout histograms has neither frequency"):
        sidecar_of(tmp_path, IMAGES, layout="histograms", bin_width_s=1e-9, axes=axes)


def test_the_command_asks_for_the_layout_of_a_file_of_bare_numbers(tmp_path):
    RAW.tofile(tmp_path / "frames.raw")
    sidecar = write_sidecar(tmp_path / "camera.toml")
    said = refusal("night-eval", "capture", "check", tmp_path / "frames.raw", "--sidecar", sidecar)
    assert "has the ending .raw: captures are read from .npz" in said
    assert "by the table binary of the sidecar" in said
