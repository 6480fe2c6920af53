"""Phasors at other frequencies from a rendered transient."""

import dataclasses

import numpy as np
import pytest
from exported_scene import BIN_M, BINS, START_M
from render_records import record_anew

from itof import TransientReader, TransientWriter, read_image, splat_residue
from render.products.conversion import ExportError, convert_to_itof
from render.products.tal_export import export_tal
from render.products.transient_deletion import delete_transients


def test_phasors_from_bins_are_the_rendered_ones(transient_dataset, transient_bins, tmp_path):
    out = convert_to_itof(transient_dataset, "000000", tmp_path / "new")
    assert out == tmp_path / "new" / "000000_itof.exr"
    rendered = read_image(transient_dataset.render_folder("000000") / "itof.exr")
    made = read_image(out)
    (z, found_hz), (exact, rendered_hz) = made.phasors(), rendered.phasors()
    assert found_hz == rendered_hz
    # docs/science/renderer.md: 1 % of the hidden part, and what bins of 5 cm leave of all light.
    hidden = np.linalg.norm(rendered.phasors("hidden")[0], axis=(0, 1))
    energy = np.linalg.norm(transient_bins.sum(axis=-1))
    residue = splat_residue(found_hz, BIN_M, "quadratic")
    assert np.all(np.linalg.norm(z - exact, axis=(0, 1)) < 0.01 * hidden + residue * energy)
    assert made.attributes["scene_id"] == "000000"
    assert made.attributes["phasors_from"] == "bins of transient.exr"
    assert "hidden_error" in rendered.attributes
    assert "hidden_error" not in made.attributes


def test_phasors_can_be_had_at_any_frequency_that_bins_carry(transient_dataset, transient_bins, tmp_path):
    out = convert_to_itof(transient_dataset, "000000", tmp_path, [62.5e6, 33e6, 33e6])
    z, found_hz = read_image(out).phasors()
    assert found_hz == (33e6, 62.5e6)
    tau_s = (START_M + (np.arange(BINS) + 0.5) * BIN_M) / 299_792_458
    for index, frequency_hz in enumerate(found_hz):
        transfer = np.sinc(frequency_hz * BIN_M / 299_792_458) ** 3
        expected = transient_bins.astype(float) @ np.exp(2j * np.pi * frequency_hz * tau_s) / transfer
        np.testing.assert_allclose(z[..., index], expected, rtol=1e-6)  # stored as float32


@pytest.mark.parametrize("frequency_hz", [65e6, 3e9])  # 3 GHz: less than two bins a period
def test_frequencies_that_bins_do_not_carry_are_refused(transient_dataset, tmp_path, frequency_hz):
    words = (
        rf"scene 000000: bins of 0\.05 m .* at {frequency_hz / 1e6:g} MHz: use frequencies up to 64\.1 MHz, "
    )
    with pytest.raises(ExportError, match=words + "or render with finer bins"):
        convert_to_itof(transient_dataset, "000000", tmp_path, [20e6, frequency_hz])
    assert list(tmp_path.iterdir()) == []
    # 1 % of a hidden part of 3e-4 of the light
    assert splat_residue(64.1e6, BIN_M, "quadratic") < 0.01 * 3e-4 < splat_residue(64.3e6, BIN_M, "quadratic")


@pytest.mark.parametrize(
    ("splat", "limit_mhz", "most"), [("tent", 64, 0.05 * 3e-4), ("point", 0.143, 0.05 * 3e-4)]
)
def test_bins_of_earlier_versions_carry_lower_frequencies(transient_copy, tmp_path, splat, limit_mhz, most):
    file = transient_copy.render_folder("000000") / "transient.exr"
    with TransientReader(file) as reader:
        axis, attributes = dataclasses.replace(reader.layout, bin_width_m=0.01), reader.attributes
        bins = np.concatenate(list(reader.row_blocks()))
    with TransientWriter(file, axis, attributes | {"splat": splat, "bin_width_m": "0.01"}) as writer:
        writer.write_rows(bins)
    record_anew(transient_copy.render_folder("000000"))
    convert_to_itof(transient_copy, "000000", tmp_path, [limit_mhz * 1e6])
    with pytest.raises(ExportError, match=rf"up to {limit_mhz:g} MHz, or render the transients again"):
        convert_to_itof(transient_copy, "000000", tmp_path, [1.01e6 * limit_mhz])
    assert splat_residue(1e6 * limit_mhz, 0.01, splat) < most < splat_residue(1.01e6 * limit_mhz, 0.01, splat)


def test_scenes_without_transients_are_refused_in_one_sentence(transient_copy, tmp_path):
    delete_transients(transient_copy, ["000000"])
    for scene in ("000000", "000001"):
        for export in (
            lambda scene=scene: export_tal(transient_copy, scene, tmp_path / "x.hdf5"),
            lambda scene=scene: convert_to_itof(transient_copy, scene, tmp_path),
        ):
            with pytest.raises(ExportError, match="render it with night-render DATASET --product both"):
                export()


def test_a_capture_that_cannot_be_written_is_refused_in_one_sentence(transient_dataset, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ExportError, match=r"cannot write .*x\.hdf5"):
        export_tal(transient_dataset, "000000", tmp_path / "file" / "x.hdf5")
    with pytest.raises(ExportError, match=r"cannot write .*_itof\.exr"):
        convert_to_itof(transient_dataset, "000000", tmp_path / "file")
