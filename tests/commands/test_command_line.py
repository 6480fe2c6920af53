"""How the commands parse and end: options made of settings, default commands, exit codes."""

import logging
import os
import signal
from importlib.metadata import version
from pathlib import Path
from typing import get_args

import click
import pytest
from night_commands import DEFECT, night_here, refusal

import cli
from itof import ImageFileError
from model.settings import TrainSettings, training_fields
from storage import NightError

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


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_knows_its_version(words):
    done = night_here(*words, "--version")
    assert (done.returncode, done.stdout) == (0, f"{words[0]}, version {version('night-nlos')}\n")


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


def test_every_training_setting_has_one_option_with_its_description_and_bounds():
    options = {option.name: option for option in options_of("night-train")}
    fields = training_fields()
    assert fields.keys() == set(TrainSettings.__dataclass_fields__)
    assert options.keys() == fields.keys() | {"out", "preset", "resume", "start_from", "as_json", "version"}
    assert len(options_of("night-train")) == len(options)
    for name, field in fields.items():
        option = options[name]
        assert option.help == field.description
        assert option.default is None  # not given: the preset or the run decides
        flag = "--" + name.removesuffix("_hz").replace("_", "-")
        assert option.opts == [flag]
        assert option.secondary_opts == ([flag.replace("--", "--no-")] if field.annotation is bool else [])
        if isinstance(option.type, click.Choice):
            assert tuple(option.type.choices) == get_args(field.annotation)
    bounds = {
        name: (options[name].type.min, options[name].type.max) for name in ("ema_decay", "rotation_deg")
    }
    assert bounds == {"ema_decay": (0, 1), "rotation_deg": (0, 180)}
    assert options["ema_decay"].type.max_open
    assert options["mask_threshold"].type.min_open
    assert not options["dead_zone"].type.min_open
    assert [name for name in fields if options[name].type.name == "MHZ,..."] == ["frequencies_hz"]
    assert isinstance(options["train_scenes"].type, click.IntRange)
    assert options["train_scenes"].type.min == 1


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
    monkeypatch.setattr(cli, "open_dataset", failing_with(error))
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
    monkeypatch.setattr(cli, "open_dataset", failing_with(KeyError("frequency")))
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
    monkeypatch.setattr(cli, "open_dataset", failing_with(error))
    assert refusal("night-render", "status", "data") == sentence
    done = night_here("night-render", "status", "data", NIGHT_TRACEBACK="1")
    assert done.returncode == 2
    assert done.stderr.startswith("Traceback")
    assert done.stderr.endswith(f"Error: {sentence}\n")


def test_signals_end_a_command_with_their_own_codes(monkeypatch):
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # `nohup` ignores it
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            monkeypatch.setattr(cli, "open_dataset", lambda _, number=number: os.kill(os.getpid(), number))
            assert night_here("night-render", "status", "data").returncode == 128 + number
    finally:
        signal.signal(signal.SIGHUP, before)
    monkeypatch.setattr(cli, "open_dataset", failing_with(KeyboardInterrupt()))
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
    assert cli.Megahertz().convert(text, None, None) == frequencies_hz
