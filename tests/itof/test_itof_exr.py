"""EXR files: what is written is read back, in blocks, and what is damaged is said to be so."""

import numpy as np
import OpenEXR
import pytest

from itof import (
    MOST_WRITTEN_BYTES,
    ImageFileError,
    MeasurementMatrix,
    TransientLayout,
    TransientReader,
    TransientWriter,
    phasor_channels,
    phasors,
    read_image,
    write_image,
)
from itof.exr.image import image_bytes

LAYOUT = TransientLayout(width=5, height=7, bin_count=11, bin_width_m=0.01, start_opl_m=0.3)


@pytest.fixture
def cube():
    return np.random.default_rng(0).random((7, 5, 11), dtype=np.float32)


@pytest.fixture
def transient_file(tmp_path, cube):
    path = tmp_path / "transient.exr"
    with TransientWriter(path, LAYOUT, {"method": "test"}) as writer:
        writer.write_rows(cube[:4])
        writer.write_rows(cube[4:])
    return path


def test_an_image_says_its_size_and_its_channels_in_a_shell(tmp_path):
    write_image(tmp_path / "i.exr", {"a": np.zeros((2, 3)), "b": np.zeros((2, 3))}, {})
    image = read_image(tmp_path / "i.exr")
    assert image.sentences == ("3 x 2 pixels", "channels a, b")
    assert repr(image) == "Image: 3 x 2 pixels\n1 more in sentences"


def test_a_transient_comes_back_bit_for_bit_in_any_blocks(transient_file, cube):
    with TransientReader(transient_file) as reader:
        assert reader.layout == LAYOUT
        assert reader.attributes["method"] == "test"
        np.testing.assert_array_equal(np.concatenate(list(reader.row_blocks(3))), cube)
        np.testing.assert_array_equal(reader.read_rows(5, 6), cube[5:6])


def test_bins_that_are_not_stored_are_dark(tmp_path, cube):
    cube[..., :3] = cube[..., 8:] = 0
    with TransientWriter(tmp_path / "a.exr", LAYOUT, {}, range(3, 8)) as writer:
        writer.write_rows(cube[..., 3:8])
    with TransientReader(tmp_path / "a.exr") as reader:
        assert reader.layout == LAYOUT
        assert reader.bins == range(3, 8)
        np.testing.assert_array_equal(np.concatenate(list(reader.row_blocks(3))), cube)
        z = reader.phasors([20e6, 60e6])
    np.testing.assert_allclose(z, phasors(cube, [20e6, 60e6], 0.01, start_opl_m=0.3), rtol=1e-12)
    plain = OpenEXR.InputFile(str(tmp_path / "a.exr")).channel("transient.Y")
    np.testing.assert_array_equal(np.frombuffer(plain, np.float32).reshape(7, 5, 5), cube[..., 3:8])


@pytest.mark.long
def test_the_largest_transient_that_is_accepted_is_written_and_read_back(tmp_path):
    layout = TransientLayout(width=320, height=209, bin_count=8000, bin_width_m=0.01, start_opl_m=0)
    assert layout.raw_bytes <= MOST_WRITTEN_BYTES < layout.raw_bytes + layout.raw_bytes // layout.height
    row = np.zeros((1, 320, 8000), np.float32)
    with TransientWriter(tmp_path / "a.exr", layout, {}) as writer:
        for number in range(209):
            row[0, number, number] = number
            writer.write_rows(row)
    with TransientReader(tmp_path / "a.exr") as reader:
        np.testing.assert_array_equal(reader.read_rows(208, 209), row)


def test_a_transient_that_would_crash_openexr_is_refused(tmp_path):
    layout = TransientLayout(width=320, height=210, bin_count=8000, bin_width_m=0.01, start_opl_m=0)
    with pytest.raises(ValueError, match="2150400000 bytes is too large: OpenEXR writes at most 2147483647"):
        TransientWriter(tmp_path / "a.exr", layout, {})
    assert list(tmp_path.iterdir()) == []


def test_an_ordinary_exr_reader_sees_time_contiguous_pixels(transient_file, cube):
    with OpenEXR.File(str(transient_file)) as file:
        pixels = file.channels()["transient.Y"].pixels
        assert file.header()["night.bin_width_m"] == "0.01"
    np.testing.assert_array_equal(pixels.reshape(7, 5, 11), cube)


def test_phasors_of_a_file_are_those_of_the_cube(transient_file, cube):
    with TransientReader(transient_file) as reader:
        streamed = reader.phasors([20e6, 60e6])
    np.testing.assert_allclose(streamed, phasors(cube, [20e6, 60e6], 0.01, start_opl_m=0.3), rtol=1e-12)


def test_phasors_keep_their_frequencies_and_values(tmp_path):
    z = (np.arange(24).reshape(2, 4, 3) * (1 - 2j)).astype(np.complex64)
    write_image(tmp_path / "itof.exr", phasor_channels(z, [20e6, 62.5e6, 60e6]), {})
    image = read_image(tmp_path / "itof.exr")
    assert {"itof.20MHz.Re", "itof.62.5MHz.Im"} <= set(image.channels)
    back, frequencies_hz = image.phasors()
    assert frequencies_hz == (20e6, 60e6, 62.5e6)
    np.testing.assert_array_equal(back, z[..., [0, 2, 1]])


def test_any_frequency_comes_back_exactly(tmp_path):
    drawn = np.random.default_rng(2).uniform(1e6, 100e6, 300)
    frequencies_hz = sorted([20e6, 62.5e6, 1e6, 1e6 + 1e-9, *drawn.tolist()])
    labels = "".join(phasor_channels(np.zeros((1, 1, len(frequencies_hz))), frequencies_hz))
    assert "itof.20MHz.Re" in labels
    assert "itof.62.5MHz.Im" in labels
    z = np.arange(len(frequencies_hz), dtype=np.complex64)[None, None]
    write_image(tmp_path / "many.exr", phasor_channels(z, frequencies_hz), {})
    back, found_hz = read_image(tmp_path / "many.exr").phasors()
    assert found_hz == tuple(frequencies_hz)
    np.testing.assert_array_equal(back, z)


def test_the_transfer_function_of_a_files_splat_is_divided_out(tmp_path):
    cube = np.random.default_rng(1).random((7, 5, 11), dtype=np.float32)
    for splat in ("quadratic", "tent", "point"):
        with TransientWriter(tmp_path / f"{splat}.exr", LAYOUT, {"splat": splat}) as writer:
            writer.write_rows(cube)
        with TransientReader(tmp_path / f"{splat}.exr") as reader:
            expected = MeasurementMatrix((60e6,), 11, 0.01, 0.3, splat=splat).apply(cube)
            np.testing.assert_allclose(reader.phasors([60e6]), expected, rtol=1e-12)
    with TransientWriter(tmp_path / "new.exr", LAYOUT, {"splat": "cubic"}) as writer:
        writer.write_rows(cube)
    with (
        TransientReader(tmp_path / "new.exr") as reader,
        pytest.raises(ImageFileError, match=r"new\.exr .* 'cubic' and not one of point, tent, quadratic"),
    ):
        reader.phasors([60e6])


def test_strided_channels_are_stored_as_they_look(tmp_path):
    values = np.arange(48, dtype=np.float32).reshape(6, 8)
    write_image(tmp_path / "a.exr", {"a": values.T, "b": values.T[::-1]}, {})
    image = read_image(tmp_path / "a.exr")
    np.testing.assert_array_equal(image.channel("a"), values.T)
    np.testing.assert_array_equal(image.channel("b"), values.T[::-1])


def test_a_file_with_missing_rows_is_never_finished(tmp_path, cube):
    with (
        pytest.raises(ValueError, match="only 4 of 7"),
        TransientWriter(tmp_path / "a.exr", LAYOUT, {}) as writer,
    ):
        writer.write_rows(cube[:4])


def test_rows_of_another_shape_are_refused(tmp_path, cube):
    with (
        pytest.raises(ValueError, match="expected rows of 5 pixels x 11 bins"),
        TransientWriter(tmp_path / "a.exr", LAYOUT, {}) as writer,
    ):
        writer.write_rows(cube[:, :4])


@pytest.mark.parametrize("keep", [0, 7, 200, 600])
def test_a_truncated_transient_is_refused_in_one_sentence(transient_file, keep):
    transient_file.write_bytes(transient_file.read_bytes()[:keep])
    with pytest.raises(ImageFileError, match="damaged or no EXR file"):
        _read_all(transient_file)


def test_a_missing_file_and_a_foreign_one_are_refused(tmp_path, transient_file, capfd):
    with pytest.raises(ImageFileError, match="does not exist"):
        read_image(tmp_path / "nowhere.exr")
    (tmp_path / "text.exr").write_text("no picture at all")
    with pytest.raises(ImageFileError, match="no EXR file"):
        read_image(tmp_path / "text.exr")
    write_image(tmp_path / "plain.exr", {"Y": np.ones((3, 4))}, {})
    with pytest.raises(ImageFileError, match="not a transient"):
        _read_all(tmp_path / "plain.exr")
    with pytest.raises(ImageFileError, match="no channel itof"):
        read_image(transient_file).phasors()
    assert capfd.readouterr().err == ""  # OpenEXR's own lines stay off the terminal


def _read_all(path):
    with TransientReader(path) as reader:
        return list(reader.row_blocks())


def test_an_image_without_compression_holds_the_same_pixels_and_its_size_is_theirs(tmp_path):
    channels = {"b.Im": np.indices((7, 300))[0], "a.Re": np.zeros((7, 300))}
    packed, plain = (image_bytes(channels, {"unit": "µm"}, packed=packed) for packed in (True, False))
    pixels = 2 * 4 * 7 * 300
    assert pixels < len(plain) < pixels + 2000  # the header and 16 bytes a row
    assert len(packed) < 0.5 * pixels
    for content in (packed, plain):
        (tmp_path / "a.exr").write_bytes(content)
        image = read_image(tmp_path / "a.exr")
        assert image.attributes == {"unit": "µm"}
        for name, values in channels.items():
            np.testing.assert_array_equal(image.channel(name), values)
