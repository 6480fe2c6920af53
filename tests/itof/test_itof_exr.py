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
from itof.exr.library import ExrOutput
from itof.exr.stretches import Stretches

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


def test_a_transient_comes_back_bit_for_bit_in_any_blocks(transient_file, cube):
    with TransientReader(transient_file) as reader:
        assert reader.layout == LAYOUT
        assert reader.attributes["method"] == "test"
        np.testing.assert_array_equal(np.concatenate(list(reader.row_blocks(3))), cube)
        np.testing.assert_array_equal(reader.read_rows(5, 6), cube[5:6])


def test_a_transient_of_an_older_version_stores_the_same_bins_of_all_pixels(tmp_path, cube):
    cube[..., :3] = cube[..., 8:] = 0
    axis = {"bin_count": "11", "bin_width_m": "0.01", "start_opl_m": "0.3"}
    bins = {"first_bin": "3", "stored_bins": "5"}
    file = ExrOutput(tmp_path / "a.exr", (25, 7), ["transient.Y"], axis | bins)
    file.write({"transient.Y": np.ascontiguousarray(cube[..., 3:8])}, 7)
    file.close(complete=True)
    with TransientReader(tmp_path / "a.exr") as reader:
        assert reader.layout == LAYOUT
        np.testing.assert_array_equal(np.concatenate(list(reader.row_blocks(3))), cube)
        z = reader.phasors([20e6, 60e6])
    np.testing.assert_allclose(z, phasors(cube, [20e6, 60e6], 0.01, start_opl_m=0.3), rtol=1e-12)


@pytest.fixture
def stretched(tmp_path):
    """A file of stretches of 2 and 4 bins, its numbers, and all bins of its pixels."""
    rng = np.random.default_rng(1)
    numbers = rng.random((7, 5, 8), dtype=np.float32)
    first = [rng.integers(0, 12 - count, (7, 5)) for count in (2, 4)]
    numbers[..., :2] = np.stack(first, axis=-1)
    dense = np.zeros((7, 5, 11), np.float32)
    for y, x in np.ndindex(7, 5):
        for begin, count, place in ((first[0][y, x], 2, 2), (first[1][y, x], 4, 4)):
            dense[y, x, begin : begin + count] += numbers[y, x, place : place + count]
    with TransientWriter(tmp_path / "a.exr", LAYOUT, {}, Stretches((2, 4))) as writer:
        writer.write_rows(numbers[:3])
        writer.write_rows(numbers[3:])
    return tmp_path / "a.exr", numbers, dense


def test_pixels_store_stretches_of_their_own_and_other_bins_are_dark(stretched):
    file, numbers, dense = stretched
    with TransientReader(file) as reader:
        assert reader.layout == LAYOUT
        np.testing.assert_array_equal(np.concatenate(list(reader.row_blocks(3))), dense)
        z = reader.phasors([20e6, 60e6])
    # Bins of both stretches of a pixel are added in float32 here.
    np.testing.assert_allclose(z, phasors(dense, [20e6, 60e6], 0.01, start_opl_m=0.3), rtol=2.0**-23)
    with OpenEXR.File(str(file)) as plain:
        assert plain.header()["night.stretches"] == "2 4"
        pixels = plain.channels()["transient.Y"].pixels
    np.testing.assert_array_equal(pixels.reshape(7, 5, 8), numbers)


@pytest.mark.parametrize("first", [-1, 8, 0.5, np.nan, np.inf])
def test_stretches_that_lie_outside_the_time_axis_are_damage(tmp_path, first):
    numbers = np.zeros((7, 5, 5), np.float32)
    numbers[6, 4, 0] = first
    with TransientWriter(tmp_path / "a.exr", LAYOUT, {}, Stretches((4,))) as writer:
        writer.write_rows(numbers)
    with TransientReader(tmp_path / "a.exr", advice="ask Ann") as reader:
        assert not reader.read_rows(0, 6).any()
        for read in (lambda: reader.read_rows(0, 7), lambda: reader.phasors([20e6])):
            with pytest.raises(ImageFileError, match=r"a\.exr is damaged .* none of its 11\): ask Ann$"):
                read()


@pytest.mark.parametrize("text", ["", "0 6", "-2 8", "12", "two", " ".join(17 * ["1"])])
def test_stretches_that_cannot_be_are_refused(tmp_path, text):
    axis = {"bin_count": "11", "bin_width_m": "0.01", "start_opl_m": "0.3", "stretches": text}
    file = ExrOutput(tmp_path / "a.exr", (40, 7), ["transient.Y"], axis)
    file.write({"transient.Y": np.zeros((7, 40), np.float32)}, 7)
    file.close(complete=True)
    with pytest.raises(ImageFileError, match="impossible time axis"):
        TransientReader(tmp_path / "a.exr")


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
        pytest.raises(ValueError, match="expected rows of 5 pixels x 11 numbers"),
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
