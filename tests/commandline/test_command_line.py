"""How the commands parse and end: options made of settings, default commands, exit codes."""

import logging
import os
import re
import signal
from importlib.metadata import version
from pathlib import Path

import click
import pytest
from night_commands import DEFECT, night_here, refusal

import cli
from commandline.options import Megahertz
from commandline.training_options import SHOWN, given_settings
from disk import NightError
from itof import ImageFileError
from model.settings.keys import all_keys, merged
from model.settings.presets import training_preset
from model.settings.target import DepthTarget
from model.settings.train_settings import TrainSettings, settings_from_dict

PROGRAMS = {
    "night-gen": cli.night_gen,
    "night-render": cli.night_render,
    "night-train": cli.night_train,
    "night-eval": cli.night_eval,
}
COMMANDS = [(name,) for name in PROGRAMS] + [
    (name, word)
    for name, program in PROGRAMS.items()
    if isinstance(program, click.Group)
    for word in program.commands
]


def options_of(*words):
    command = PROGRAMS[words[0]]
    for word in words[1:]:
        command = command.commands[word]
    return [parameter for parameter in command.params if isinstance(parameter, click.Option)]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_explains_itself_and_its_options(words):
    done = night_here(*words, "--help")
    assert done.returncode == 0
    assert done.stdout.startswith("Usage: " + words[0])
    assert all(option.help for option in options_of(*words))


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_program_knows_its_version(program):
    done = night_here(program, "--version")
    assert (done.returncode, done.stdout) == (0, f"{program}, version {version('night-nlos')}\n")


@pytest.mark.parametrize(("program", "default"), [("night-render", "render"), ("night-eval", "judge")])
def test_the_help_of_a_program_shows_the_options_of_its_main_job_and_its_other_commands(program, default):
    text = night_here(program, "--help").stdout
    for option in options_of(program, default):
        assert option.opts[0] in text
    listed = text[text.index("Commands:") :].split("\n")
    assert [line.split()[0] for line in listed[1:-1]] == sorted(PROGRAMS[program].commands)


@pytest.mark.parametrize("words", [("night-render", "nowhere"), ("night-render", "render", "nowhere")])
def test_the_word_of_the_main_job_may_be_left_out(words):
    assert "there is no folder nowhere" in refusal(*words)


MOST_OPTIONS = {("night-train",): 27}  # with --help and --version
MOST_OTHERS = 17  # fifteen, --help and --version


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_no_command_shows_more_options_than_a_person_can_read(words):
    if isinstance(PROGRAMS[words[0]], click.Group) and len(words) == 1:
        return  # its commands are judged
    text = night_here(*words, "--help").stdout
    shown = re.findall(r"^  (--[a-z-]+)", text, flags=re.MULTILINE)
    assert len(shown) <= MOST_OPTIONS.get(words, MOST_OTHERS)


def test_night_train_shows_the_options_that_people_set_under_headings():
    text = night_here("night-train", "--help").stdout
    shown = re.findall(r"^  (--[a-z-]+)", text, flags=re.MULTILINE)
    assert shown == [*dict.fromkeys(shown)]
    headings = ["Options", "Settings", *SHOWN]
    assert re.findall(r"^([A-Z][a-z]+):$", text, flags=re.MULTILINE) == headings
    assert {f"--{flag}" for flags in SHOWN.values() for flag in flags} <= set(shown)


def test_an_option_of_a_setting_has_its_bounds_and_says_what_it_is():
    options = {option.opts[0]: option for option in options_of("night-train")}
    for flags in SHOWN.values():
        for flag, key in flags.items():
            assert options[f"--{flag}"].default is None, key  # not given: the preset or the run decides
            assert options[f"--{flag}"].help
    width, rate = (options[name].type for name in ("--width", "--learning-rate"))
    assert (width.min, width.max, rate.min, rate.max) == (1, 1_000_000, 1e-37, 1e37)
    assert options["--target"].type.choices == ("components", "depth", "mask+depth")
    assert options["--reference"].type.choices == ("geometry", "capture", "self", "self+wiggling")
    assert options["--frequencies"].type.name == "MHZ,..."
    assert options["--progress"].secondary_opts == ["--no-progress"]


def test_every_setting_has_a_description():
    assert [
        key for key, field in all_keys(TrainSettings) if not field.description and ".sensor." not in key
    ] == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["network.widht=3"], "options: unknown key network.widht: the nearest are network.width"),
        (["width=3"], "options: unknown key width: the nearest are network.width"),
        (["network.width=2.5"], "options: network.width must be a whole number (got 2.5)"),
        (["network.width"], "'network.width' is no setting: write it like network.width=32"),
        (["network.width="], "'network.width=' is no setting: write it like network.width=32"),
        (["target.alpha=1"], "target.alpha goes with target.kind components or depth, and it is mask+depth"),
        (
            ["target.kind=paper"],
            "target.kind must be one of 'components', 'depth', 'mask+depth' (got 'paper')",
        ),
        (["target=5"], "target must be a table of keys and values (got 5)"),
        (["network.width=1", "network.width=0"], "network.width must be greater than or equal to 1 (got 0)"),
    ],
)
def test_a_setting_that_there_is_not_is_refused_in_one_sentence(closed_form_scenes, tmp_path, given, words):
    assignments = [word for each in given for word in ("--set", each)]
    said = refusal("night-train", closed_form_scenes.root, "--out", tmp_path / "run", *assignments)
    assert words in said
    assert not (tmp_path / "run").exists()


def test_settings_come_from_defaults_preset_options_and_set_in_this_order():
    chosen = {f"{key}".replace(".", "_"): None for flags in SHOWN.values() for key in flags.values()}
    given = given_settings(
        chosen | {"network_width": 8, "target_kind": "depth", "input_frequencies_hz": (2e7, 5e7)},
        ("network.width=9", "run.patience = 3", "target.loss=mse", "augmentation.paper.translation=0.1"),
    )
    assert given == {
        "input": {"frequencies_hz": (2e7, 5e7)},
        "network": {"width": 9},
        "target": {"kind": "depth", "loss": "mse"},
        "run": {"patience": 3},
        "augmentation": {"paper": {"translation": 0.1}},
    }
    found = settings_from_dict(merged(training_preset("paper")[0], given), "options")
    assert (found.network.width, found.network.levels, found.run.patience) == (9, 5, 3)
    backwards = given_settings(chosen, ("target.loss=mse", "target.kind=depth"))
    assert backwards == {"target": {"kind": "depth", "loss": "mse"}}
    assert found.target == DepthTarget(loss="mse")  # another kind, with its own defaults
    assert (found.augmentation.paper.translation, found.augmentation.paper.rotation_deg) == (0.1, 180)


def failing_with(error):
    def fail(*_):
        raise error

    return fail


@pytest.mark.parametrize(
    "error",
    [
        KeyError("frequency"),
        ValueError("odd"),
        RuntimeError("odd"),
        ZeroDivisionError("odd"),
        EOFError("odd"),
    ],
    ids=repr,
)
def test_an_unexpected_exception_is_a_defect_with_a_traceback(monkeypatch, error):
    monkeypatch.setattr("commandline.rendering.open_dataset", failing_with(error))
    done = night_here("night-render", "status", "data", defect=True)
    assert (done.returncode, done.stdout) == (DEFECT, "")
    lines = done.stderr.splitlines()
    assert lines[0] == "Traceback (most recent call last):"
    assert repr(error).split("(")[0] in lines[-2]
    assert lines[-1] == (
        f"This is a defect of NIGHT {version('night-nlos')}: please report it with the text above (see "
        "CONTRIBUTING.md)."
    )


def test_a_defect_while_options_are_parsed_is_one_too(monkeypatch):
    monkeypatch.setattr("commandline.options.Size.convert", failing_with(KeyError("odd")))
    for words in (("data",), ("status", "data")):
        done = night_here("night-render", *words, "--resolution", "4x3", defect=True)
        assert done.returncode == DEFECT
        assert done.stderr.endswith("(see CONTRIBUTING.md).\n")


def test_tests_see_a_defect_as_a_failure(monkeypatch):
    monkeypatch.setattr("commandline.rendering.open_dataset", failing_with(KeyError("frequency")))
    with pytest.raises(AssertionError, match="KeyError: 'frequency'"):
        night_here("night-render", "status", "data")


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (NightError("the dataset\nis odd"), "the dataset is odd"),
        (ImageFileError("x.exr is damaged"), "x.exr is damaged"),
        (OSError("no space"), "no space"),
        (TimeoutError(), "TimeoutError"),
    ],
    ids=repr,
)
def test_what_a_user_can_change_is_one_sentence(monkeypatch, error, sentence):
    monkeypatch.setattr("commandline.rendering.open_dataset", failing_with(error))
    assert refusal("night-render", "status", "data") == sentence
    done = night_here("night-render", "status", "data", NIGHT_TRACEBACK="1")
    assert done.returncode == 2
    assert done.stderr.startswith("Traceback")
    assert done.stderr.endswith(f"Error: {sentence}\n")


def test_signals_end_a_command_with_their_own_codes(monkeypatch):
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # `nohup` ignores it
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            monkeypatch.setattr(
                "commandline.rendering.open_dataset", lambda _, number=number: os.kill(os.getpid(), number)
            )
            assert night_here("night-render", "status", "data").returncode == 128 + number
    finally:
        signal.signal(signal.SIGHUP, before)
    monkeypatch.setattr("commandline.rendering.open_dataset", failing_with(KeyboardInterrupt()))
    done = night_here("night-render", "status", "data")
    assert (done.returncode, done.stderr) == (128 + signal.SIGINT, "interrupted\n")


def test_a_command_in_this_process_leaves_no_trace_in_it(tmp_path):
    before = (signal.getsignal(signal.SIGTERM), Path.cwd(), logging.root.handlers[:], logging.root.level)
    done = night_here("night-render", "status", "nowhere", cwd=tmp_path, NIGHT_ODD="1")
    assert done.returncode == 2
    after = (signal.getsignal(signal.SIGTERM), Path.cwd(), logging.root.handlers[:], logging.root.level)
    assert after == before
    assert "NIGHT_ODD" not in os.environ


@pytest.mark.parametrize(
    ("text", "frequencies_hz"),
    [
        ("20", (20e6,)),
        ("62.5,20", (20e6, 62.5e6)),
        ("0.1", (1e5,)),
        ("20,20", (20e6,)),
        (" 7e1 ,3", (3e6, 7e7)),
    ],
)
def test_frequencies_are_given_in_megahertz_in_any_order(text, frequencies_hz):
    assert Megahertz().convert(text, None, None) == frequencies_hz
