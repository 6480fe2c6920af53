"""Prediction on one's own data and the ONNX file: same numbers every way in, one sentence for bad input."""

import io
import json
import os
import pickle
import shutil
import sys
import zipfile
from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch
import trimesh
from click.testing import CliRunner
from pydantic import TypeAdapter
from safetensors.torch import load_file, save_file
from synthetic_dataset import write_synthetic_dataset

import cli
from itof import phasor_channels, pixel_rays, read_image, split_components, write_image
from model.data.shards import open_shards
from model.network.wall_view import WallView, wall_view
from model.prediction.measurement_files import MeasurementError, read_measurement
from model.prediction.onnx_export import INPUT, METADATA, OUTPUT, ExportError, export_onnx
from model.prediction.prediction_files import PredictionError, predict_file
from model.prediction.predictor import load
from model.run_folder import RUN_SCHEMA, RunConfig, RunError
from model.settings import TrainSettings
from model.training.loop import train

FREQUENCIES_HZ = (20e6, 50e6, 60e6)


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=12)


@pytest.fixture(scope="module")
def run(dataset, tmp_path_factory):
    """A run that has learnt enough to show objects."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    quick = {"width": 8, "batch_size": 2, "max_epochs": 10, "learning_rate": 2e-3, "progress": False}
    train(dataset, folder, TrainSettings(**quick, device="cpu"))
    return folder


@pytest.fixture
def copy(run, tmp_path):
    """A copy of the run, to be spoilt."""
    shutil.copytree(run, tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture(scope="module")
def predictor(run):
    return load(run, "cpu")


@pytest.fixture(scope="module")
def shards(dataset):
    return open_shards(dataset)


@pytest.fixture(scope="module")
def phasors(shards):
    """(3, H, W, F) phasors of the first scenes."""
    return shards.complex_phasors([0, 1, 2])


@pytest.fixture
def exr(dataset):
    return dataset.render_folder(dataset.ids()[0]) / "itof.exr"


def write_npz(path, **changes):
    """An .npz measurement at the usual frequencies; a change of None leaves the array out."""
    arrays = {"frequencies_hz": np.array(FREQUENCIES_HZ)} | changes
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})
    return path


def write_h5(path, **arrays):
    with h5py.File(path, "w") as file:
        for name, values in ({"frequencies_hz": FREQUENCIES_HZ} | arrays).items():
            file[name] = values
    return path


def predict(run, file, out, **options):
    return predict_file(run, file, out, device="cpu", progress=False, **options)


def written(out, name="000000"):
    """(radial depth, mask, phasor) of a prediction's EXR."""
    image = read_image(out / f"{name}.exr")
    (phasor,), frequencies_hz = np.moveaxis(image.phasors()[0], -1, 0), image.phasors()[1]
    assert frequencies_hz == FREQUENCIES_HZ[:1]
    return image.channel("depth.R"), image.channel("mask.M"), phasor


def assert_same(out, other, name="000000"):
    for ours, theirs in zip(written(out, name), written(other, name), strict=True):
        np.testing.assert_array_equal(ours, theirs)


# Python


def test_the_view_of_the_wall_comes_back_exactly_from_json(dataset, predictor):
    view = wall_view(dataset)
    adapter = TypeAdapter(WallView)
    assert adapter.validate_json(adapter.dump_json(view)) == view
    assert predictor.config.geometry == view
    rng = np.random.default_rng(4)
    numbers = rng.standard_normal(18).tolist()
    odd = WallView(
        horizontal_fov_deg=59.99999999999999,
        camera_axes=tuple(tuple(numbers[i : i + 3]) for i in (0, 3, 6)),
        camera_location_m=tuple(numbers[9:12]),
        wall_point_m=tuple(numbers[12:15]),
        wall_normal=tuple(numbers[15:]),
    )
    assert adapter.validate_json(adapter.dump_json(odd)) == odd


def test_the_reference_of_a_run_is_that_of_the_shards(predictor, shards):
    np.testing.assert_array_equal(predictor.reference, shards.reference)


def test_a_prediction_needs_no_reference_and_keeps_single_images(predictor, phasors, shards):
    given = predictor.predict(phasors, shards.reference)
    many, one = predictor.predict(phasors), predictor.predict(phasors[1])
    np.testing.assert_array_equal(many.depth, given.radial_depth_m)
    assert many.mask.any(axis=(1, 2)).all()
    assert one.depth.shape == phasors.shape[1:3]
    np.testing.assert_allclose(one.phasor, many.phasor[1], atol=1e-5)


def test_z_depth_is_radial_depth_times_the_rays_cosine(predictor, phasors):
    one = predictor.predict(phasors[0])
    height, width = one.mask.shape
    cosine = pixel_rays(width, height, 60.0)[..., 2]
    np.testing.assert_allclose(one.z_depth_m(60.0), one.depth * cosine, rtol=1e-12)


def test_a_thousandfold_measurement_has_the_same_depth_when_rescaled(predictor, phasors):
    own = predictor.predict(phasors, rescale=True)
    scaled = predictor.predict(1000 * phasors, 7 * predictor.reference, rescale=True)
    np.testing.assert_array_equal(scaled.mask, own.mask)
    np.testing.assert_allclose(scaled.depth, own.depth, atol=1e-4)
    trusted = predictor.predict(1000 * phasors)
    assert np.abs(trusted.phasor - own.phasor).max() > 1


def test_phasors_that_are_none_are_refused(predictor, phasors):
    for spoilt, words in (
        (phasors.real, "complex phasors, got float32"),
        (split_components(phasors), r"got \(3, 14, 24, 6\)"),
        (phasors[:, :, :-1], r"expected phasors of shape \(14, 24, 3\)"),
        (phasors[..., :2], r"got \(3, 14, 24, 2\)"),
        (phasors[:0], r"got \(0, 14, 24, 3\)"),
        (phasors[0, 0], r"expected phasors of shape \(H, W, F\) or"),
        (phasors * np.inf, "NaN or infinite"),
        (phasors.astype(np.complex128) * 1e200, "too large for the network"),
    ):
        with pytest.raises(ValueError, match=words):
            predictor.predict(spoilt)
    with pytest.raises(ValueError, match=r"reference of shape \(14, 24, 3\), got \(14, 24, 2\)"):
        predictor.predict(phasors, predictor.reference[..., :2])
    with pytest.raises(ValueError, match="the reference holds NaN"):
        predictor.predict(phasors, predictor.reference * np.nan)
    dark = np.stack([phasors[0], 0 * phasors[0]])
    with pytest.raises(ValueError, match="image 1 of 2 holds no light"):
        predictor.predict(dark, rescale=True)


# Files


def test_a_rendered_measurement_predicts_what_the_evaluation_predicts(run, exr, shards, predictor, tmp_path):
    (image,) = predict(run, exr, tmp_path / "out")
    expected = predictor.predict(shards.complex_phasors([0]), shards.reference)
    depth_m, mask, phasor = written(tmp_path / "out")
    np.testing.assert_array_equal(depth_m, expected.depth[0])
    np.testing.assert_array_equal(mask, expected.mask[0])
    np.testing.assert_array_equal(phasor, expected.phasor[0])
    assert image.object_pixels == np.count_nonzero(expected.mask[0]) > 0
    assert image.median_radial_depth_m == pytest.approx(np.median(depth_m[mask > 0]))
    assert {file.name for file in (tmp_path / "out").iterdir()} == {*image.files, "prediction.json"}
    truth = read_image(exr.with_name("mirrored.exr"))
    assert read_image(tmp_path / "out" / "000000.exr").channels.keys() == truth.channels.keys()


def test_npz_hdf5_and_exr_agree(run, exr, tmp_path):
    phasors, frequencies_hz = read_image(exr).phasors()
    predict(run, exr, tmp_path / "exr")
    npz = write_npz(tmp_path / "m.npz", phasors=phasors, frequencies_hz=np.array(frequencies_hz))
    predict(run, npz, tmp_path / "npz", rescale=False)
    assert_same(tmp_path / "npz", tmp_path / "exr")
    for ending in ("h5", "hdf5", "H5"):
        h5 = write_h5(tmp_path / f"m.{ending}", phasors=phasors[None])
        predict(run, h5, tmp_path / ending, rescale=False)
        assert_same(tmp_path / ending, tmp_path / "exr")


def test_an_exr_keeps_its_unit_and_a_cameras_is_rescaled(run, exr, tmp_path):
    phasors = read_image(exr).phasors()[0]
    files = [write_npz(tmp_path / f"{gain}.npz", phasors=gain * phasors) for gain in (1, 1024)]
    for file in files:
        predict(run, file, tmp_path / file.stem)
    assert_same(tmp_path / "1024", tmp_path / "1")
    predict(run, exr, tmp_path / "exr", rescale=True)
    assert_same(tmp_path / "exr", tmp_path / "1")
    brighter = tmp_path / "brighter.exr"
    write_image(brighter, phasor_channels(1024 * phasors, FREQUENCIES_HZ), {})
    predict(run, brighter, tmp_path / "trusted")
    assert np.abs(written(tmp_path / "trusted")[2] - written(tmp_path / "1")[2]).max() > 1


def test_frequencies_may_stand_in_any_order_and_more_of_them(run, phasors, tmp_path):
    predict(run, write_npz(tmp_path / "a.npz", phasors=phasors), tmp_path / "a")
    order = [2, 0, 1]
    other = np.concatenate([phasors[..., order], np.ones_like(phasors[..., :1])], axis=-1)
    frequencies_hz = np.array([60e6, 20e6, 50e6, 70e6], np.float32)
    shuffled = write_npz(tmp_path / "b.npz", phasors=other, frequencies_hz=frequencies_hz)
    predict(run, shuffled, tmp_path / "b")
    for name in ("000000", "000001", "000002"):
        assert_same(tmp_path / "a", tmp_path / "b", name)


def test_a_capture_of_the_empty_corner_replaces_the_computed_reference(run, phasors, predictor, tmp_path):
    # The direct return itself, as another camera's unit would have it, and in the file's order.
    order, empty = [1, 2, 0], 5e4 * predictor.reference
    arrays = {"phasors": phasors[..., order], "frequencies_hz": np.array(FREQUENCIES_HZ)[order]}
    predict(run, write_npz(tmp_path / "own.npz", **arrays), tmp_path / "own")
    captured = write_npz(tmp_path / "captured.npz", **arrays, reference=empty[..., order])
    predict(run, captured, tmp_path / "captured")
    np.testing.assert_allclose(written(tmp_path / "captured")[2], written(tmp_path / "own")[2], atol=1e-3)
    record = json.loads((tmp_path / "captured" / "prediction.json").read_text())
    assert (record["reference"], record["rescaled"]) == ("measured", True)
    # A wall that stands 10 cm nearer turns the phase: another reference is another prediction.
    turned = empty * np.exp(-4j * np.pi * 0.1 * np.array(FREQUENCIES_HZ) / 299_792_458.0)
    moved = write_npz(tmp_path / "moved.npz", **arrays, reference=turned[..., order])
    predict(run, moved, tmp_path / "moved")
    assert np.abs(written(tmp_path / "moved")[2] - written(tmp_path / "own")[2]).max() > 0.1


def test_points_lie_on_the_rays_of_their_pixels_at_the_predicted_depth(run, exr, dataset, tmp_path):
    predict(run, exr, tmp_path / "out")
    depth_m, mask, _ = written(tmp_path / "out")
    height, width = mask.shape
    rays = pixel_rays(width, height, dataset.preset.camera.horizontal_fov_deg)
    cloud = trimesh.load(tmp_path / "out" / "000000.ply")
    np.testing.assert_allclose(cloud.vertices, (rays * depth_m[..., None])[mask > 0], rtol=1e-6, atol=1e-6)


def test_where_no_pixel_shows_an_object_there_is_no_point_cloud(copy, exr, tmp_path):
    weights = load_file(copy / "best.safetensors")
    last = max(name for name in weights if name.startswith("head."))
    weights |= {name: torch.zeros_like(w) for name, w in weights.items() if name[:6] == last[:6]}
    save_file(weights, copy / "best.safetensors")
    (image,) = predict(copy, exr, tmp_path / "out")
    assert image.sentence == "image 000000: no pixel shows an object, so it has no point cloud"
    assert image.files == ("000000.exr", "000000.png")
    assert not list((tmp_path / "out").glob("*.ply"))


def test_a_prediction_replaces_nothing_but_an_earlier_prediction(run, exr, phasors, dataset, tmp_path):
    three = write_npz(tmp_path / "three.npz", phasors=phasors)
    predict(run, three, tmp_path / "out")
    predict(run, exr, tmp_path / "out")
    assert {file.stem for file in (tmp_path / "out").iterdir()} == {"000000", "prediction"}
    # A measurement that was put beside it is not ours to delete, whatever its name.
    shutil.copy(exr, tmp_path / "out" / "000001.exr")
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "out", run, dataset.root, exr.parent):
        before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
        with pytest.raises(PredictionError, match="holds other things than an earlier prediction"):
            predict(tmp_path / "no run", exr, out)
        assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before
    with pytest.raises(PredictionError, match="is a file"):
        predict(run, exr, tmp_path / "file")


def test_an_interrupted_prediction_leaves_the_earlier_one_as_it_was(run, exr, phasors, tmp_path, monkeypatch):
    predict(run, exr, tmp_path / "out")
    before = {file: file.read_bytes() for file in (tmp_path / "out").iterdir()}
    monkeypatch.setattr("model.prediction.prediction_files.BATCH", 1)
    seen = 0

    def interrupt(*_: object) -> None:
        nonlocal seen
        seen += 1
        if seen == 2:
            raise KeyboardInterrupt

    three = write_npz(tmp_path / "three.npz", phasors=phasors)
    hook = torch.nn.modules.module.register_module_forward_hook(
        lambda module, *_: interrupt() if type(module).__name__ == "UNet" else None
    )
    try:
        with pytest.raises(KeyboardInterrupt):
            predict(run, three, tmp_path / "out")
    finally:
        hook.remove()
    assert {file: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["out", "three.npz"]


def test_a_network_of_some_frequencies_takes_them_from_the_file_and_keeps_the_truths(dataset, tmp_path):
    # It sees 50 and 60 MHz, and predicts the phasor at the dataset's first frequency.
    quick = {"width": 2, "batch_size": 3, "max_epochs": 1, "progress": False, "device": "cpu"}
    train(dataset, tmp_path / "run", TrainSettings(**quick, frequencies_hz=FREQUENCIES_HZ[1:]))
    some, shards = load(tmp_path / "run", "cpu"), open_shards(dataset)
    np.testing.assert_array_equal(some.reference, shards.reference[..., 1:])
    expected = some.predict(shards.complex_phasors([0])[..., 1:])
    predict(tmp_path / "run", dataset.render_folder(dataset.ids()[0]) / "itof.exr", tmp_path / "out")
    np.testing.assert_array_equal(written(tmp_path / "out")[2], expected.phasor[0])


# Refusals


def bare_array(path, phasors):
    np.save(path.with_suffix(".npy"), phasors)
    path.with_suffix(".npy").rename(path)


def pickled_array(path, phasors):
    write_npz(path, phasors=np.array([phasors, None], dtype=object))


def pickle_file(path, phasors):
    path.write_bytes(pickle.dumps({"phasors": phasors}))


def truncated(path, phasors):
    write_npz(path, phasors=phasors)
    path.write_bytes(path.read_bytes()[:-200])


def with_nan(phasors):
    spoilt = phasors.copy()
    spoilt[1, 2, 3, 0] = np.nan
    return spoilt


def damaged_header(path, phasors):
    """An archive whose array's header lost its brace."""
    write_npz(path, phasors=phasors)
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    contents["phasors.npy"] = contents["phasors.npy"].replace(b"}", b"(", 1)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, content)


NPZ_REFUSALS = {
    "one bare array": bare_array,
    "pickled Python objects": pickled_array,
    "pickled Python objects, which could run": pickle_file,
    "damaged or no .npz archive": truncated,
    "damaged or no .npz archive (": damaged_header,
    "no array phasors; it holds frequencies_hz, phase": lambda p, z: write_npz(p, phase=z),
    "no array frequencies_hz; it holds phasors": lambda p, z: write_npz(p, phasors=z, frequencies_hz=None),
    "must be complex, Re + j Im, got float32": lambda p, z: write_npz(p, phasors=z.real),
    "must have the shape (H, W, F) or (N, H, W, F), got (14, 24)": lambda p, z: write_npz(
        p, phasors=z[0, ..., 0]
    ),
    "must have 3 values on its last axis": lambda p, z: write_npz(p, phasors=z[..., :2]),
    "image 1 of phasors holds 1 values that are NaN": lambda p, z: write_npz(p, phasors=with_nan(z)),
    "holds images of 23x14 pixels": lambda p, z: write_npz(p, phasors=z[:, :, 1:]),
    "holds images of 14x24 pixels": lambda p, z: write_npz(p, phasors=np.swapaxes(z, 1, 2)),
    "holds 20, 60 MHz, the network also needs 50 MHz": lambda p, z: write_npz(
        p, phasors=z[..., [0, 2]], frequencies_hz=np.array([20e6, 60e6])
    ),
    "frequencies_hz is in Hz, not MHz": lambda p, z: write_npz(
        p, phasors=z, frequencies_hz=np.array([20, 50, 60])
    ),
    "frequencies_hz must be a list of numbers": lambda p, z: write_npz(
        p, phasors=z, frequencies_hz=np.array(["20 MHz"])
    ),
    "frequencies_hz must be different positive numbers": lambda p, z: write_npz(
        p, phasors=z, frequencies_hz=np.array([20e6, 20e6, -1])
    ),
    "reference of shape (13, 24, 3) does not fit": lambda p, z: write_npz(p, phasors=z, reference=z[0, 1:]),
    "reference holds 1008 values that are NaN": lambda p, z: write_npz(p, phasors=z, reference=z[0] * np.nan),
    "reference is 0 in 336 pixels that have light": lambda p, z: write_npz(p, phasors=z, reference=0 * z[0]),
    "holds no light at the first frequency": lambda p, z: write_npz(p, phasors=0 * z),
}


def refusal(*words):
    """The one sentence on stderr of a night-eval that must end with exit code 2."""
    result = CliRunner().invoke(cli.night_eval, [str(word) for word in words])
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


@pytest.mark.parametrize("words", NPZ_REFUSALS)
def test_an_unusable_npz_is_refused_in_one_sentence(run, phasors, tmp_path, words):
    NPZ_REFUSALS[words](tmp_path / "m.npz", phasors)
    message = refusal("predict", run, tmp_path / "m.npz", "--out", tmp_path / "out", "--device", "cpu")
    assert words in message
    assert "m.npz" in message
    assert not (tmp_path / "out").exists()


def test_files_that_hold_no_measurement_are_refused_in_one_sentence(run, exr, phasors, tmp_path):
    (tmp_path / "no.h5").write_text("no HDF5")
    (tmp_path / "group.h5").mkdir()
    whole = write_h5(tmp_path / "m.h5", phasors=phasors)
    (tmp_path / "half.h5").write_bytes(whole.read_bytes()[:3000])
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_group("phasors")
    (tmp_path / "half.exr").write_bytes(exr.read_bytes()[:-300])
    shutil.copy(exr.with_name("mirrored.exr"), tmp_path / "truth.exr")
    write_image(tmp_path / "photo.exr", {"R": np.ones((14, 24))}, {})
    (tmp_path / "m.png").write_bytes(b"")
    for name, words in (
        ("nowhere.npz", "does not exist"),
        ("nowhere.exr", "does not exist"),
        ("group.h5", "is a folder"),
        ("no.h5", "no HDF5 file"),
        ("half.h5", "damaged or no HDF5 file"),
        ("other.h5", "no array phasors; it holds phasors"),
        ("half.exr", "damaged or no EXR"),
        ("truth.exr", "holds 20 MHz, the network also needs 50, 60 MHz"),
        ("photo.exr", "holds no phasors"),
        ("m.png", "has the ending .png: measurements are read from .exr, .npz, .h5, .hdf5 files"),
    ):
        message = refusal("predict", run, tmp_path / name, "--out", tmp_path / "out")
        assert words in message, message
        assert name in message
        assert not (tmp_path / "out").exists()


class Payload:
    """An object whose unpickling would make a folder."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_no_file_runs_code_when_it_is_read(dataset, run, copy, exr, phasors, tmp_path):
    struck = tmp_path / "struck"
    malicious = [pickle.dumps(Payload(struck), protocol=2)]  # as torch.save has it
    stream = io.BytesIO()
    torch.save({"schema_version": RUN_SCHEMA, "network": Payload(struck)}, stream)
    malicious.append(stream.getvalue())
    for content in malicious:
        (copy / "checkpoint.pt").write_bytes(content)
        with pytest.raises(RunError, match=r"checkpoint.pt is damaged or no checkpoint"):
            train(dataset, copy, replace(load(copy, "cpu").config.settings, max_epochs=11), resume=True)
        (tmp_path / "m.npz").write_bytes(content)
        with pytest.raises(MeasurementError, match=r"pickled Python objects|no array phasors"):
            read_measurement(tmp_path / "m.npz")
        (copy / "best.safetensors").write_bytes(content)
        with pytest.raises(RunError, match="damaged or no safetensors"):
            load(copy, "cpu")
        shutil.copy(run / "best.safetensors", copy)
    np.savez(tmp_path / "object.npz", phasors=np.array([Payload(struck)], dtype=object))
    with pytest.raises(MeasurementError, match="pickled Python objects"):
        read_measurement(tmp_path / "object.npz")
    assert not struck.exists()
    pickle.loads(malicious[0])  # noqa: S301, the payload does strike where it is let
    assert struck.exists()


def test_a_run_of_a_newer_program_is_refused(dataset, copy, exr, tmp_path):
    state = torch.load(copy / "checkpoint.pt", weights_only=True)
    torch.save(state | {"schema_version": RUN_SCHEMA + 1}, copy / "checkpoint.pt")
    settings = replace(load(copy, "cpu").config.settings, max_epochs=11)
    with pytest.raises(RunError, match=rf"no checkpoint of schema version {RUN_SCHEMA}"):
        train(dataset, copy, settings, resume=True)
    config = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(config | {"schema_version": RUN_SCHEMA + 1}))
    for words in (("predict", copy, exr), ("export", copy), (copy, dataset.root)):
        message = refusal(*words, "--out", tmp_path / "new.onnx")
        assert f"schema version {RUN_SCHEMA + 1}, this program reads version {RUN_SCHEMA}" in message


def test_truncated_weights_and_foreign_folders_are_refused(copy, exr, tmp_path):
    content = (copy / "best.safetensors").read_bytes()
    for length in (0, 4, 100, len(content) - 1):
        (copy / "best.safetensors").write_bytes(content[:length])
        assert "damaged or no safetensors" in refusal("predict", copy, exr, "--out", tmp_path / "out")
    assert "is no training run" in refusal("predict", tmp_path, exr, "--out", tmp_path / "out")
    assert "holds other things" in refusal("predict", copy, exr, "--out", copy)
    assert "there is no folder" in refusal("export", tmp_path / "no", "--out", tmp_path / "a.onnx")


# The command


def night_eval(*words):
    result = CliRunner().invoke(cli.night_eval, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    return result.stdout


def test_the_command_predicts_and_says_what_it_saw(run, exr, phasors, tmp_path):
    printed = night_eval("predict", run, exr, "--out", tmp_path / "out", "--device", "cpu")
    assert "pixels show an object, at a median radial depth of" in printed
    assert printed.endswith(f"depth maps, pictures and point clouds in {tmp_path / 'out'}\n")
    predict(run, exr, tmp_path / "python")
    assert_same(tmp_path / "out", tmp_path / "python")
    npz = write_npz(tmp_path / "m.npz", phasors=phasors)
    for word, rescaled in (("--no-rescale", False), ("--rescale", True)):
        night_eval("predict", run, npz, "--out", tmp_path / "out", "--device", "cpu", word)
        record = json.loads((tmp_path / "out" / "prediction.json").read_text())
        assert record["rescaled"] is rescaled
        assert [image["name"] for image in record["images"]] == ["000000", "000001", "000002"]


def test_night_eval_judges_where_no_other_command_is_named(run, dataset, tmp_path):
    report, cpu = tmp_path / "report", ("--device", "cpu")
    printed = night_eval(run, dataset.root, "--out", report, *cpu)
    assert "no object" in printed
    # Options first, and the word itself.
    assert night_eval("--out", report, *cpu, run, dataset.root) == printed
    assert night_eval("judge", run, dataset.root, "--out", report, *cpu) == printed
    for words, message in (
        ([run], "Missing argument 'DATASET'"),
        ([run, dataset.root, "--out", report, "--mask-threshold", "0"], "not in the range x>0"),
        ([run, dataset.root, "--out", report, "--mask-threshold", "nan"], "an amplitude above 0, got nan"),
    ):
        result = CliRunner().invoke(cli.night_eval, [str(word) for word in words])
        assert result.exit_code == 2
        assert message in result.stderr


def test_night_eval_explains_its_three_uses():
    text = night_eval("--help")
    for words in ("night-eval RUN DATASET --out", "night-eval predict RUN INPUT --out", "export RUN --out"):
        assert words in text
    assert "--split" in text
    assert "--mask-threshold" in text
    for command, words in (("predict", "frequencies_hz"), ("export", "components"), ("judge", "--split")):
        assert words in night_eval(command, "--help")


# ONNX


def test_the_onnx_file_computes_what_torch_computes(run, predictor, phasors, tmp_path):
    import onnxruntime

    printed = night_eval("export", run, "--out", tmp_path / "model.onnx")
    assert "differs from PyTorch by at most" in printed
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]
    session = onnxruntime.InferenceSession(str(tmp_path / "model.onnx"), providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    assert TypeAdapter(RunConfig).validate_json(metadata[METADATA]) == predictor.config
    channels = predictor.config.inputs.apply(phasors, predictor.reference)
    (node,) = session.get_inputs()
    assert (node.name, node.shape[1:], node.type) == (INPUT, list(channels.shape[1:]), "tensor(float)")
    check = export_onnx(run, tmp_path / "again.onnx")
    for count in (1, 2, 3):
        (components,) = session.run([OUTPUT], {INPUT: channels[:count]})
        with torch.no_grad():
            expected = predictor.network(torch.from_numpy(channels[:count])).numpy()
        np.testing.assert_allclose(components, expected, atol=check.tolerance)
    # A float32 network of 22 layers errs by some roundings of outputs near 1, not by what an object is.
    assert check.largest_difference <= check.tolerance < 1e-4 * max(check.largest_output, 1)
    assert check.largest_output > 1e-3  # dead units throughout would compare nothing


def test_an_export_that_computes_something_else_is_refused(run, tmp_path, monkeypatch):
    def another_network(network, config):
        with torch.no_grad():
            weight = network.head[-1].weight
            kept = weight.clone()
            weight *= 1.01
        try:
            return model_of(network, config)
        finally:
            with torch.no_grad():
                weight.copy_(kept)

    from model.prediction import onnx_export

    model_of = onnx_export._onnx_model
    monkeypatch.setattr(onnx_export, "_onnx_model", another_network)
    with pytest.raises(ExportError, match="computes something else than PyTorch"):
        export_onnx(run, tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []


def test_an_export_says_what_is_missing_and_where_it_may_go(run, tmp_path, monkeypatch):
    (tmp_path / "folder.onnx").mkdir()
    for name in ("model.pt", "folder.onnx"):
        assert "file that ends in .onnx" in refusal("export", run, "--out", tmp_path / name)
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    message = refusal("export", run, "--out", tmp_path / "model.onnx")
    assert "needs onnxscript" in message
    assert "night-nlos[onnx]" in message
