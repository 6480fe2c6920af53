"""Training settings: presets, and values that are refused by name."""

import json
import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from disk import PresetError
from itof.wall.wall_view import WallView
from model.network.channels import InputSpec
from model.run_folder.run_config import RunConfig, StartingWeights
from model.settings.keys import merged, tables
from model.settings.presets import training_preset
from model.settings.train_settings import TrainSettings, flat_settings, plain_settings, settings_from_dict

PRESETS = Path(__file__).parents[3] / "data" / "training"


def test_settings_refuse_what_makes_no_sense():
    for key, value in (
        ("input.channels.kind", "all"),
        ("optimiser.batch_size", 0),
        ("optimiser.learning_rate", -1.0),
        ("run.device", "tpu"),
        ("input.frequencies_hz", [5e7, 2e7]),
        ("network.levels", 9),
        ("target.mask_gradient", "depth"),
    ):
        with pytest.raises(PresetError, match=f"^mine.toml: .*{key.rsplit('.', maxsplit=1)[-1]}"):
            settings_from_dict(merged({"target": {"kind": "components"}}, tables({key: value})), "mine.toml")


def test_a_number_of_epochs_that_no_schedule_can_count_is_refused():
    with pytest.raises(PresetError, match="max_epochs must be less than or equal to 1000000000"):
        settings_from_dict({"run": {"max_epochs": 10**400}}, "mine.toml")


@pytest.mark.parametrize("group", ["input", "network", "target", "optimiser", "augmentation", "run"])
def test_what_is_no_table_is_refused_by_its_key(group):
    for value in (None, 5, "x", [1]):
        with pytest.raises(PresetError, match=f"^mine.toml: {group} must be a table of keys and values"):
            settings_from_dict({group: value}, "mine.toml")


def test_a_key_that_goes_with_another_kind_says_with_which():
    with pytest.raises(
        PresetError, match=r"target\.smooth_l1_beta goes with target\.kind mask\+depth, and it is"
    ):
        settings_from_dict({"target": {"kind": "depth", "smooth_l1_beta": 0.1}}, "mine.toml")


def test_the_defaults_are_those_of_the_preset_default_and_survive_json():
    assert settings_from_dict(*training_preset("default")) == TrainSettings()
    for name in ("default", "paper", "known-wall", "five-levels"):
        chosen = settings_from_dict(*training_preset(name))
        assert settings_from_dict(json.loads(json.dumps(plain_settings(chosen))), "run.json") == chosen


def test_every_ablation_differs_from_the_paper_by_its_own_keys():
    paper = flat_settings(settings_from_dict(*training_preset("paper")))
    for file in PRESETS.glob("ablation-*.toml"):
        own = tomllib.loads(file.read_text())
        assert own.pop("extends") == "paper"
        ablation = flat_settings(settings_from_dict(*training_preset(file.stem)))
        changed = {key for key in {*paper, *ablation} if paper.get(key) != ablation.get(key)}
        (group,) = own  # one table
        (key,) = own[group] if group == "input" or len(own[group]) == 1 else ("",)
        assert all(name.startswith(f"{group}.{key}") for name in changed), file


def test_a_preset_extends_one_beside_it_table_by_table(tmp_path):
    (tmp_path / "base.toml").write_text(
        '[network]\nwidth = 5\nlevels = 2\n[target]\nkind = "depth"\nalpha = 1\n'
    )
    (tmp_path / "mine.toml").write_text('extends = "base.toml"\n[network]\nwidth = 6\n')
    data, origin = training_preset(str(tmp_path / "mine.toml"))
    assert data == {"network": {"width": 6, "levels": 2}, "target": {"kind": "depth", "alpha": 1}}
    assert origin.endswith("mine.toml")


def test_another_kind_replaces_the_table_of_the_base(tmp_path):
    (tmp_path / "base.toml").write_text('[target]\nkind = "depth"\nalpha = 1\n')
    (tmp_path / "mine.toml").write_text('extends = "base.toml"\n[target]\nkind = "mask+depth"\n')
    assert training_preset(tmp_path / "mine.toml")[0] == {"target": {"kind": "mask+depth"}}


def test_tables_that_are_far_too_deep_are_refused_by_their_first_key(tmp_path):
    deep = ".".join(["network", *["x"] * 5000]) + " = 1\n"
    (tmp_path / "base.toml").write_text(deep)
    (tmp_path / "mine.toml").write_text(f'extends = "base.toml"\n{deep}')
    with pytest.raises(PresetError, match=r"unknown key network\.x"):
        settings_from_dict(*training_preset(tmp_path / "mine.toml"))


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
