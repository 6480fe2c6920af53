"""The ONNX file computes what PyTorch computes, or is not written."""

import json
import sys

import numpy as np
import pytest
import torch
from night_commands import night_here, refusal
from pydantic import TypeAdapter
from training_runs import edit_weights

from model.data.shards import open_shards
from model.prediction import onnx_export
from model.prediction.onnx_export import INPUT, METADATA
from model.prediction.predictor import load
from model.run_folder.run_config import RunConfig

pytestmark = pytest.mark.usefixtures("one_thread")


def test_the_onnx_file_computes_what_torch_computes(seeing_run, closed_form_scenes, tmp_path):
    import onnxruntime

    done = night_here("night-eval", "export", seeing_run, "--out", tmp_path / "model.onnx", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert set(said) == {"file", "largest_difference", "tolerance", "largest_output"}
    tolerance, largest_output = said["tolerance"], said["largest_output"]
    assert f"{tmp_path / 'model.onnx'}: differs from PyTorch by at most {said['largest_difference']:.2g}" in (
        done.stderr
    )
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]
    session = onnxruntime.InferenceSession(str(tmp_path / "model.onnx"), providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    predictor = load(seeing_run, "cpu")
    assert TypeAdapter(RunConfig).validate_json(metadata[METADATA]) == predictor.config
    phasors = open_shards(closed_form_scenes).read([0, 1, 2]).phasors
    channels = predictor.config.inputs.apply(phasors, predictor.reference)
    (node,) = session.get_inputs()
    assert (node.name, node.shape[1:], node.type) == (INPUT, list(channels.shape[1:]), "tensor(float)")
    for count in (1, 2, 3):
        (components,) = session.run(["components"], {INPUT: channels[:count]})
        with torch.no_grad():
            expected = predictor.network(torch.from_numpy(channels[:count])).numpy()
        np.testing.assert_allclose(components, expected, atol=tolerance)
    # Rounding of a float32 network of 22 layers, far below the amplitude of an object.
    assert tolerance < 1e-4 * max(largest_output, 1)
    assert largest_output > 1e-3  # with outputs of 0 alone, nothing would be compared


@pytest.mark.long
def test_an_export_that_computes_something_else_is_refused(seeing_run, tmp_path, monkeypatch):
    def another_network(network, config):
        with torch.no_grad():
            network.head[-1].weight *= 1.01
        model = model_of(network, config)
        with torch.no_grad():
            network.head[-1].weight /= 1.01
        return model

    model_of = onnx_export._onnx_model
    monkeypatch.setattr(onnx_export, "_onnx_model", another_network)
    message = refusal("night-eval", "export", seeing_run, "--out", tmp_path / "model.onnx")
    assert "computes something else than PyTorch" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_network_that_answers_with_infinite_values_is_not_exported(finished_copy, tmp_path):
    edit_weights(finished_copy, lambda _, weight: weight * 0 + 1e30)
    message = refusal("night-eval", "export", finished_copy, "--out", tmp_path / "model.onnx")
    assert "answers with NaN or infinite values" in message
    assert not (tmp_path / "model.onnx").exists()


def test_an_export_says_what_is_missing_and_where_it_may_go(finished_run, tmp_path, monkeypatch):
    (tmp_path / "folder.onnx").mkdir()
    for name in ("model.pt", "folder.onnx"):
        message = refusal("night-eval", "export", finished_run, "--out", tmp_path / name)
        assert "file that ends in .onnx" in message
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    message = refusal("night-eval", "export", finished_run, "--out", tmp_path / "model.onnx")
    assert "night-eval export needs the package onnxscript: pip install 'night-nlos[onnx]'" in message
