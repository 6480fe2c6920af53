"""Training settings: presets, and values that are refused by name."""

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from itof.wall.wall_view import WallView
from model.network.channels import InputSpec
from model.run_folder.run_config import RunConfig, StartingWeights
from model.settings import TrainSettings, settings_from_dict, training_preset
from storage import PresetError

PRESETS = Path(__file__).parents[2] / "data" / "training"


def test_settings_refuse_what_makes_no_sense():
    for change in ({"channels": "all"}, {"batch_size": 0}, {"learning_rate": -1.0}, {"device": "tpu"}):
        with pytest.raises(ValueError, match=next(iter(change))):
            TrainSettings(**change)
    with pytest.raises(ValueError, match="least_reflectance needs residual channels"):
        TrainSettings(channels="paper", least_reflectance=0.5)


def test_a_number_of_epochs_that_no_schedule_can_count_is_refused():
    with pytest.raises(PresetError, match="max_epochs must be less than or equal to 1000000000"):
        settings_from_dict({"max_epochs": 10**400}, "mine.toml")


def test_every_training_preset_is_one_that_settings_take_and_differs_from_its_base_by_its_own_keys():
    paper = settings_from_dict(*training_preset("paper"))
    for file in PRESETS.glob("*.toml"):
        preset = settings_from_dict(*training_preset(file.stem))
        if file.stem.startswith("ablation-"):
            own = {key for key in tomllib.loads(file.read_text()) if key != "extends"}
            # What is predicted and the threshold for it go together.
            assert len(own) == (2 if file.stem == "ablation-direct-depth" else 1), file
            names = [field.name for field in fields(TrainSettings)]
            changed = {name for name in names if getattr(preset, name) != getattr(paper, name)}
            assert changed <= own, file


def test_a_preset_extends_one_beside_it(tmp_path):
    (tmp_path / "base.toml").write_text('width = 5\nloss = "mse"\n')
    (tmp_path / "mine.toml").write_text('extends = "base.toml"\nwidth = 6\n')
    data, origin = training_preset(str(tmp_path / "mine.toml"))
    assert data == {"width": 6, "loss": "mse"}
    assert origin.endswith("mine.toml")


def test_presets_that_extend_each_other_in_a_circle_are_refused(tmp_path):
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.toml").write_text(f'extends = "{other}.toml"\n')
    with pytest.raises(PresetError, match="circle"):
        training_preset(str(tmp_path / "a.toml"))


@pytest.mark.parametrize("name", ["nothing_of_this_name", "../../elsewhere", "x" * 5000])
def test_a_bad_name_to_extend_is_refused_with_the_file_that_has_it(tmp_path, name):
    file = tmp_path / "mine.toml"
    file.write_text(f'extends = "{name}"\n')
    with pytest.raises(PresetError, match=re.escape(f"{file}, key extends: ")):
        training_preset(file)


def test_the_page_of_files_names_every_key_of_run_json():
    page = (PRESETS.parent.parent / "docs" / "reference" / "files.md").read_text()
    section = page.split("### run.json")[1].split("###")[0]
    nested = {"inputs": InputSpec, "geometry": WallView, "started_from": StartingWeights}
    names = {field.name for part in (RunConfig, *nested.values()) for field in fields(part)} - {"inputs"}
    assert {name for name in names if f"`{name}`" not in section and f".{name}`" not in section} == set()
