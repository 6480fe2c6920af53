"""Prediction on measurement files: every format gives the same numbers; other files are kept."""

import json
import shutil
from dataclasses import replace
from io import BytesIO

import matplotlib.pyplot as plt
import numpy as np
import pytest
import trimesh
from measurements import FREQUENCIES_HZ, assert_same, write_h5, write_npz, written
from night_commands import night_here
from PIL import Image
from training_runs import before_each_network, blind, settings

from itof import phase_per_metre, phasor_channels, pixel_rays, read_image, write_image
from model.prediction.prediction_files import PredictionError, predict_file
from model.prediction.predictor import load
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")


def predict(run, file, out, **options):
    """Also where a network that has seen a few scenes explains nothing of the light."""
    return predict_file(run, file, out, **{"device": "cpu", "progress": False, "force": True} | options)


def contents(folder):
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_a_rendered_measurement_predicts_what_the_evaluation_predicts(seeing_run, exr, shards, tmp_path):
    (image,) = predict(seeing_run, exr, tmp_path / "out").images
    expected = load(seeing_run, "cpu").predict(shards.read([0]).phasors, shards.reference)[0]
    found = written(tmp_path / "out")
    np.testing.assert_array_equal(found.radial_depth_m, expected.radial_depth_m)
    np.testing.assert_array_equal(found.mask, expected.mask)
    np.testing.assert_array_equal(found.phasor, expected.phasor)
    assert image.object_pixels == np.count_nonzero(expected.mask) > 0
    assert image.median_radial_depth_m == pytest.approx(np.median(found.radial_depth_m[found.mask]))
    assert {file.name for file in (tmp_path / "out").iterdir()} == {*image.files, "prediction.json"}
    truth = read_image(exr.with_name("mirrored.exr"))
    assert read_image(tmp_path / "out" / "000000.exr").channels.keys() == truth.channels.keys()


def test_points_lie_on_the_rays_of_their_pixels_at_the_predicted_depth(
    seeing_run, exr, closed_form_scenes, tmp_path
):
    predict(seeing_run, exr, tmp_path / "out")
    found = written(tmp_path / "out")
    height, width = found.mask.shape
    rays = pixel_rays(width, height, closed_form_scenes.preset.camera.horizontal_fov_deg)
    expected = (rays * found.radial_depth_m[..., None])[found.mask]
    cloud = trimesh.load(tmp_path / "out" / "000000.ply")
    np.testing.assert_allclose(cloud.vertices, expected, rtol=1e-6, atol=1e-6)


def test_where_no_pixel_shows_an_object_there_is_no_point_cloud(finished_copy, exr, tmp_path):
    blind(finished_copy)
    prediction = predict(finished_copy, exr, tmp_path / "out")
    (image,) = prediction.images
    assert repr(prediction) == f"FilePrediction of 1 image in {tmp_path / 'out'}\n{image.sentence}"
    told, light = image.sentence.split("; ")
    assert told == "image 000000: no pixel shows an object, so it has no point cloud"
    assert light.startswith("0 % of the hidden light is explained, which is ")
    assert image.files == ("000000.exr", "000000.png")
    assert not list((tmp_path / "out").glob("*.ply"))


@pytest.mark.long
def test_npz_hdf5_and_exr_agree(seeing_run, exr, tmp_path):
    phasors, frequencies_hz = read_image(exr).phasors()
    predict(seeing_run, exr, tmp_path / "exr")
    npz = write_npz(tmp_path / "m.npz", phasors=phasors, frequencies_hz=np.array(frequencies_hz))
    predict(seeing_run, npz, tmp_path / "npz", rescale=False)
    assert_same(tmp_path / "npz", tmp_path / "exr")
    for ending in ("h5", "hdf5", "H5"):
        h5 = write_h5(tmp_path / f"m.{ending}", phasors=phasors[None])
        predict(seeing_run, h5, tmp_path / ending, rescale=False)
        assert_same(tmp_path / ending, tmp_path / "exr")


def test_an_exr_keeps_its_unit_and_a_cameras_is_rescaled(seeing_run, exr, tmp_path):
    phasors = read_image(exr).phasors()[0]
    for gain in (1, 1024):
        npz = write_npz(tmp_path / f"{gain}.npz", phasors=gain * phasors)
        predict(seeing_run, npz, tmp_path / str(gain))
    assert_same(tmp_path / "1024", tmp_path / "1")
    predict(seeing_run, exr, tmp_path / "exr", rescale=True)
    assert_same(tmp_path / "exr", tmp_path / "1")
    brighter = tmp_path / "brighter.exr"
    write_image(brighter, phasor_channels(1024 * phasors, FREQUENCIES_HZ), {})
    predict(seeing_run, brighter, tmp_path / "trusted")
    assert np.abs(written(tmp_path / "trusted").phasor - written(tmp_path / "1").phasor).max() > 1


@pytest.mark.long
def test_a_file_may_hold_more_frequencies_in_any_order(seeing_run, phasors, tmp_path):
    predict(seeing_run, write_npz(tmp_path / "a.npz", phasors=phasors[:2]), tmp_path / "a")
    other = np.concatenate([phasors[:2][..., [2, 0, 1]], np.ones_like(phasors[:2, ..., :1])], axis=-1)
    frequencies_hz = np.array([60e6, 20e6, 50e6, 70e6], np.float32)
    predict(
        seeing_run,
        write_npz(tmp_path / "b.npz", phasors=other, frequencies_hz=frequencies_hz),
        tmp_path / "b",
    )
    for name in ("000000", "000001"):
        assert_same(tmp_path / "a", tmp_path / "b", name)


@pytest.mark.long
def test_a_capture_of_the_empty_corner_replaces_the_computed_reference(seeing_run, phasors, tmp_path):
    # The direct return itself in the unit of another camera, and in the order of the file.
    order, empty = [1, 2, 0], 5e4 * load(seeing_run, "cpu").reference
    arrays = {"phasors": phasors[0][..., order], "frequencies_hz": np.array(FREQUENCIES_HZ)[order]}
    predict(seeing_run, write_npz(tmp_path / "own.npz", **arrays), tmp_path / "own")
    captured = write_npz(tmp_path / "captured.npz", **arrays, reference=empty[..., order])
    predict(seeing_run, captured, tmp_path / "captured")
    own = written(tmp_path / "own").phasor
    # complex64 rounds by 6e-8 of the direct return, which is 6e-5 of the residual's scale, 1e-3 of it.
    np.testing.assert_allclose(written(tmp_path / "captured").phasor, own, atol=1e-3)
    record = json.loads((tmp_path / "captured" / "prediction.json").read_text())
    assert (record["reference"], record["rescaled"]) == ("measured", True)
    # A wall that stands 10 cm nearer turns the phase: another reference is another prediction.
    turned = empty * np.exp(-1j * 2 * 0.1 * phase_per_metre(FREQUENCIES_HZ))
    moved = write_npz(tmp_path / "moved.npz", **arrays, reference=turned[..., order])
    predict(seeing_run, moved, tmp_path / "moved", force=True)
    assert np.abs(written(tmp_path / "moved").phasor - own).max() > 0.1


def test_a_network_of_some_frequencies_takes_them_from_the_file_and_keeps_the_truths(
    closed_form_scenes, shards, exr, tmp_path
):
    # It sees 50 and 60 MHz, and predicts the phasor at the dataset's first frequency.
    train(closed_form_scenes, tmp_path / "run", settings(max_epochs=1, frequencies_hz=FREQUENCIES_HZ[1:]))
    some = load(tmp_path / "run", "cpu")
    np.testing.assert_array_equal(some.reference, shards.reference[..., 1:])
    expected = some.predict(shards.read([0]).phasors[..., 1:])
    predict(tmp_path / "run", exr, tmp_path / "out")
    np.testing.assert_array_equal(written(tmp_path / "out").phasor, expected.phasor[0])


def test_a_prediction_replaces_nothing_but_an_earlier_prediction(
    seeing_run, exr, phasors, closed_form_scenes, tmp_path
):
    predict(seeing_run, write_npz(tmp_path / "two.npz", phasors=phasors[:2]), tmp_path / "out")
    predict(seeing_run, exr, tmp_path / "out")
    assert {file.stem for file in (tmp_path / "out").iterdir()} == {"000000", "prediction"}
    figure = (tmp_path / "out" / "000000.png").read_bytes()
    (tmp_path / "out" / "000000.png").write_bytes(figure + b"mine")
    with pytest.raises(PredictionError, match=r"an earlier prediction: 000000\.png \(changed\); move"):
        predict(tmp_path / "no run", exr, tmp_path / "out")
    (tmp_path / "out" / "000000.png").write_bytes(figure)
    (tmp_path / "out" / "deep").mkdir()
    with pytest.raises(PredictionError, match="an earlier prediction: deep/; move"):
        predict(tmp_path / "no run", exr, tmp_path / "out")
    (tmp_path / "out" / "deep").rmdir()
    # A measurement in the folder of the prediction is kept, whatever its name.
    shutil.copy(exr, tmp_path / "out" / "000001.exr")
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "out", seeing_run, closed_form_scenes.root, exr.parent):
        before = contents(out)
        with pytest.raises(PredictionError, match="holds other things than an earlier prediction"):
            predict(tmp_path / "no run", exr, out)
        assert contents(out) == before
    with pytest.raises(PredictionError, match="is a file"):
        predict(seeing_run, exr, tmp_path / "file")


def test_pictures_are_optional_and_change_no_number(seeing_run, exr, tmp_path):
    (drawn,) = predict(seeing_run, exr, tmp_path / "drawn").images
    (bare,) = predict(seeing_run, exr, tmp_path / "bare", pictures=False).images
    assert bare == replace(drawn, files=tuple(name for name in drawn.files if name != "000000.png"))
    assert not list((tmp_path / "bare").glob("*.png"))
    assert_same(tmp_path / "bare", tmp_path / "drawn")


def test_a_dark_image_can_be_forced_and_drawn(seeing_run, phasors, tmp_path):
    dark = write_npz(tmp_path / "dark.npz", phasors=0 * phasors[:1])
    (image,) = predict(seeing_run, dark, tmp_path / "out", rescale=False).images
    assert (image.light.strength, image.light.share) == (0, None)
    assert (tmp_path / "out" / "000000.png").is_file()


def test_a_notebook_shows_the_pictures_and_no_markup_of_others(seeing_run, exr, phasors, tmp_path):
    two = write_npz(tmp_path / "two.npz", phasors=phasors[:2], **{"<b>": np.zeros(1)})
    predicted = predict(seeing_run, two, tmp_path / "out")
    shown = predicted._repr_html_()
    assert shown.count('<img src="data:image/png;base64,') == 2
    figure = predicted.plot()
    plt.close(figure)
    assert all(axes.images[0].get_array().std() > 0.1 for axes in figure.axes)
    assert len(figure.axes) == 2
    assert "<b>" not in shown
    assert "&lt;b&gt;" in shown
    one = written(tmp_path / "out")
    with Image.open(BytesIO(one._repr_png_())) as picture:
        assert picture.format == "PNG"
    bare = predict(seeing_run, exr, tmp_path / "bare", pictures=False)
    assert "<img" not in bare._repr_html_()
    with pytest.raises(PredictionError, match="bare has no pictures: predict with pictures=True"):
        bare.plot()


@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_a_film_has_a_frame_for_each_image_and_in_the_folder_is_part_of_the_prediction(
    seeing_run, exr, phasors, tmp_path, ending
):
    two, out = write_npz(tmp_path / "two.npz", phasors=phasors[:2]), tmp_path / "out"
    predict(seeing_run, two, out, film=out / f"film.{ending}", pictures=False)
    predict(seeing_run, two, out, film=tmp_path / f"film.{ending}")
    assert {file.suffix for file in out.iterdir()} == {".exr", ".ply", ".png", ".json"}
    with Image.open(tmp_path / f"film.{ending}") as film:
        assert film.n_frames == 2
        for place in range(2):
            film.seek(place)
            with Image.open(out / f"{place:06d}.png") as picture:  # with the colours of the film
                difference = np.asarray(film.convert("RGB"), float) - np.asarray(picture)
        assert np.abs(difference).mean() < 5  # of 255: a GIF has 256 colours, a WebP loses details


@pytest.mark.parametrize(
    ("film", "words"), [("film.mp4", "a film is a .gif or .webp file"), ("there.gif", "is a folder")]
)
def test_what_cannot_be_a_film_is_refused_before_any_work(seeing_run, exr, tmp_path, film, words):
    (tmp_path / "there.gif").mkdir()
    with pytest.raises(PredictionError, match=words):
        predict(tmp_path / "no run", exr, tmp_path / "out", film=tmp_path / film)


def test_an_interrupted_prediction_leaves_the_earlier_one_as_it_was(
    seeing_run, exr, phasors, tmp_path, monkeypatch
):
    predict(seeing_run, exr, tmp_path / "out")
    before = contents(tmp_path / "out")
    monkeypatch.setattr("model.prediction.prediction_files.BATCH", 1)
    batches = []

    def interrupt_the_second(network) -> None:
        batches.append(network)
        if len(batches) == 2:
            raise KeyboardInterrupt

    two = write_npz(tmp_path / "two.npz", phasors=phasors[:2])
    with before_each_network(interrupt_the_second), pytest.raises(KeyboardInterrupt):
        predict(seeing_run, two, tmp_path / "out")
    assert contents(tmp_path / "out") == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["out", "two.npz"]


@pytest.mark.long
def test_the_command_predicts_and_says_what_it_saw(seeing_run, exr, phasors, tmp_path):
    out = ("--out", tmp_path / "out", "--device", "cpu")
    done = night_here("night-eval", "predict", seeing_run, exr, *out, "--force")
    assert done.returncode == 0, done.stderr
    assert "pixels show an object, at a median radial depth of" in done.stdout
    assert done.stdout.endswith(f"depth maps, pictures and point clouds in {tmp_path / 'out'}\n")
    predict(seeing_run, exr, tmp_path / "python")
    assert_same(tmp_path / "out", tmp_path / "python")
    npz = write_npz(tmp_path / "m.npz", phasors=phasors[:2])
    for word, rescaled in (("--no-rescale", False), ("--rescale", True)):
        done = night_here("night-eval", "predict", seeing_run, npz, *out, word, "--json", "--force")
        assert done.returncode == 0, done.stderr
        record = json.loads((tmp_path / "out" / "prediction.json").read_text())
        assert json.loads(done.stdout) == record
        assert "image 000001: " in done.stderr
        assert record["rescaled"] is rescaled
        assert [image["name"] for image in record["images"]] == ["000000", "000001"]
