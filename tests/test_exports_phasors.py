"""Phasors at other frequencies from a rendered transient, and renders without transients."""

from dataclasses import replace

import numpy as np
import pytest
from exported_scene import BIN_M, BINS, START_M

from itof import read_image
from render.products.conversion import ExportError, convert_to_itof, shrink_to_itof
from render.products.tal_export import export_tal
from render.products.verification import verify_scene
from scenegen import read_record


def test_phasors_from_bins_are_the_rendered_ones(transient_dataset, tmp_path):
    out = convert_to_itof(transient_dataset, "000000", tmp_path / "new")
    assert out == tmp_path / "new" / "000000_itof.exr"
    rendered = read_image(transient_dataset.render_folder("000000") / "itof.exr")
    made = read_image(out)
    (z, found_hz), (exact, rendered_hz) = made.phasors(), rendered.phasors()
    assert found_hz == rendered_hz
    # docs/rendering.md: 1 % of the hidden part at bins of 1 cm. The direct return's 5 cm bins are summed with
    # the tent divided out, exact for light spread over bins; a pixel's edges are not, in (kw)^2 / 12 of it.
    hidden = np.linalg.norm(rendered.phasors("hidden")[0])
    direct = np.linalg.norm(rendered.phasors("direct")[0])
    assert np.linalg.norm(z - exact) < 0.01 * hidden + (2 * np.pi * 60e6 / 3e8 * BIN_M) ** 2 / 12 * direct
    assert made.attributes["scene_id"] == "000000"
    assert made.attributes["phasors_from"] == "bins of transient.exr"
    assert "hidden_error" in rendered.attributes
    assert "hidden_error" not in made.attributes


def test_phasors_can_be_had_at_any_frequency_that_bins_resolve(transient_dataset, transient_bins, tmp_path):
    out = convert_to_itof(transient_dataset, "000000", tmp_path, [62.5e6, 33e6, 33e6])
    z, found_hz = read_image(out).phasors()
    assert found_hz == (33e6, 62.5e6)
    tau_s = (START_M + (np.arange(BINS) + 0.5) * BIN_M) / 299_792_458
    for index, frequency_hz in enumerate(found_hz):
        tent = np.sinc(frequency_hz * BIN_M / 299_792_458) ** 2
        expected = transient_bins.astype(float) @ np.exp(2j * np.pi * frequency_hz * tau_s) / tent
        np.testing.assert_allclose(z[..., index], expected, rtol=1e-6)  # stored as float32


def test_frequencies_that_bins_cannot_resolve_are_refused(transient_dataset, tmp_path):
    with pytest.raises(ExportError, match=r"scene 000000: bins of 0\.05 m cannot resolve 3000 MHz"):
        convert_to_itof(transient_dataset, "000000", tmp_path, [20e6, 3e9])
    assert list(tmp_path.iterdir()) == []


def test_a_scene_shrinks_to_its_phasors_and_stays_a_whole_render(transient_copy):
    folder = transient_copy.render_folder("000000")
    before, images = read_record(folder), (folder / "itof.exr").read_bytes()
    size = sum((folder / name).stat().st_size for name in ("transient.exr", "mirrored_transient.exr"))
    assert shrink_to_itof(transient_copy, "000000") == size
    assert {f.name for f in folder.iterdir()} == {"itof.exr", "mirrored.exr", "render.json"}
    assert (folder / "itof.exr").read_bytes() == images
    kept = {name: before.files[name] for name in ("itof.exr", "mirrored.exr")}
    assert read_record(folder) == replace(before, files=kept)
    assert verify_scene(transient_copy, "000000") == []
    assert shrink_to_itof(transient_copy, "000000") == 0


def test_transients_stay_where_the_phasors_are_not_whole(transient_copy):
    folder = transient_copy.render_folder("000000")
    (folder / "itof.exr").write_bytes((folder / "itof.exr").read_bytes()[:-100])
    with pytest.raises(ExportError, match=r"itof\.exr is missing or not what was rendered"):
        shrink_to_itof(transient_copy, "000000")
    assert (folder / "transient.exr").is_file()
    assert "transient.exr" in read_record(folder).files


def test_what_an_interrupted_shrinking_left_is_deleted_by_the_next(transient_copy):
    folder = transient_copy.render_folder("000000")
    kept = (folder / "transient.exr").read_bytes()
    shrink_to_itof(transient_copy, "000000")
    (folder / "transient.exr").write_bytes(kept)  # the record was written, the file not yet deleted
    assert shrink_to_itof(transient_copy, "000000") == len(kept)
    assert not (folder / "transient.exr").exists()


def test_scenes_without_transients_are_refused_in_one_sentence(transient_copy, tmp_path):
    shrink_to_itof(transient_copy, "000000")
    for scene in ("000000", "000001"):
        for export in (
            lambda scene=scene: export_tal(transient_copy, scene, tmp_path / "x.hdf5"),
            lambda scene=scene: convert_to_itof(transient_copy, scene, tmp_path),
        ):
            with pytest.raises(ExportError, match="render it with night-render DATASET --product both"):
                export()
    with pytest.raises(ExportError, match="is not rendered"):
        shrink_to_itof(transient_copy, "000001")


def test_a_capture_that_cannot_be_written_is_refused_in_one_sentence(transient_dataset, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ExportError, match=r"cannot write .*x\.hdf5"):
        export_tal(transient_dataset, "000000", tmp_path / "file" / "x.hdf5")
    with pytest.raises(ExportError, match=r"cannot write .*_itof\.exr"):
        convert_to_itof(transient_dataset, "000000", tmp_path / "file")
