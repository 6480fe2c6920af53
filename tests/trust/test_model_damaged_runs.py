"""Missing, damaged, foreign and malicious run folders are refused in one sentence; no code in them runs."""

import io
import os
import pickle
import shutil

import numpy as np
import pytest
import torch
from night_commands import refusal
from training_runs import config_of, edit_checkpoint, edit_config, edit_settings, settings

from disk.checksums import label_text, labelled
from itof.files.measurement_files import MeasurementError, read_measurement
from model.prediction.predictor import load
from model.run_folder.run_config import RUN_SCHEMA, RunError
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def resume(closed_form_scenes, finished_copy):
    """Go on with the copy of a run by more epochs, so that its checkpoint is used."""
    return lambda **changes: train(
        closed_form_scenes, finished_copy, settings(**{"max_epochs": 3} | changes), resume=True
    )


def test_unusable_runs_are_refused_in_one_sentence(finished_copy, tmp_path):
    with pytest.raises(RunError, match="there is no folder"):
        load(tmp_path / "nowhere")
    (tmp_path / "foreign").mkdir()
    with pytest.raises(RunError, match="is no training run"):
        load(tmp_path / "foreign")
    weights, config = finished_copy / "best.safetensors", finished_copy / "run.json"
    content = weights.read_bytes()
    weights.write_bytes(content[: len(content) // 2])
    with pytest.raises(RunError, match=r"best.safetensors is damaged"):
        load(finished_copy)
    weights.unlink()
    with pytest.raises(RunError, match=r"has no best.safetensors"):
        load(finished_copy)
    edit_settings(finished_copy, widht=3)
    with pytest.raises(RunError, match=r"unknown key settings.widht"):
        load(finished_copy)
    config.write_text("[1, 2")
    with pytest.raises(RunError, match="is not the JSON of a run"):
        load(finished_copy)


def test_weights_of_another_architecture_are_refused(finished_copy, resume):
    edit_settings(finished_copy, width=3)
    with pytest.raises(RunError, match="weights of another architecture"):
        load(finished_copy)
    with pytest.raises(RunError, match="weights of another architecture"):
        resume(width=3)


def test_a_run_of_a_newer_program_is_refused(finished_copy, resume, closed_form_scenes, tmp_path):
    edit_checkpoint(finished_copy, schema_version=RUN_SCHEMA + 1)
    with pytest.raises(RunError, match=rf"no checkpoint of schema version {RUN_SCHEMA}"):
        resume()
    edit_config(finished_copy, schema_version=RUN_SCHEMA + 1)
    exr = closed_form_scenes.render_folder("000000") / "itof.exr"
    for words in (
        ("predict", finished_copy, exr),
        ("export", finished_copy),
        (finished_copy, closed_form_scenes.root),
    ):
        message = refusal("night-eval", *words, "--out", tmp_path / "new.onnx")
        assert f"schema version {RUN_SCHEMA + 1}, this program reads version {RUN_SCHEMA}" in message


class Payload:
    """An object whose unpickling would make a folder."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_no_file_runs_code_when_it_is_read(finished_run, finished_copy, resume, tmp_path):
    struck, run_id = tmp_path / "struck", config_of(finished_copy)["run_id"]
    malicious = [pickle.dumps(Payload(struck), protocol=2)]  # the protocol of torch.save
    stream = io.BytesIO()
    torch.save({"schema_version": RUN_SCHEMA, "network": Payload(struck)}, stream)
    malicious.append(stream.getvalue())
    for content in (*malicious, *(labelled(content + label_text(run_id).encode()) for content in malicious)):
        (finished_copy / "checkpoint.pt").write_bytes(content)
        with pytest.raises(RunError, match=r"checkpoint.pt is damaged"):
            resume()
        (tmp_path / "m.npz").write_bytes(content)
        with pytest.raises(MeasurementError, match=r"pickled Python objects|no array phasors"):
            read_measurement(tmp_path / "m.npz")
        (finished_copy / "best.safetensors").write_bytes(content)
        with pytest.raises(RunError, match=r"is damaged|is no safetensors file"):
            load(finished_copy, "cpu")
        shutil.copy(finished_run / "best.safetensors", finished_copy)
    np.savez(tmp_path / "object.npz", phasors=np.array([Payload(struck)], dtype=object))
    with pytest.raises(MeasurementError, match="pickled Python objects"):
        read_measurement(tmp_path / "object.npz")
    assert not struck.exists()
    pickle.loads(malicious[0])  # noqa: S301, shows that the payload works where it is unpickled
    assert struck.exists()
