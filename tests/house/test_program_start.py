"""How a program starts: with modules of its own, open streams, a place for caches, and few open files."""

import itertools
import os
import signal
import stat
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.metadata import version

import pytest
from night_commands import PRESET, TRAINING, night, words
from source_tree import ROOMS, ROOT

import night_nlos
from commandline.streams_and_caches import prepare_process
from disk.private_folder import private_folder

PROGRAMS = ("night-gen", "night-render", "night-train", "night-eval")
FULL = "/dev/full"


def shell(line, *arguments, **environment):
    """Run a shell command in which "$@" stands for `arguments`."""
    return subprocess.run(
        ["bash", "-c", line, "bash", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


# Modules


def test_the_project_has_one_version_and_four_programs():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert night_nlos.__version__ == version("night-nlos") == project["project"]["version"]
    functions = {name: f"night_nlos:{name.replace('-', '_')}" for name in PROGRAMS}
    assert project["project"]["scripts"] == functions
    assert {function.split(":")[1] for function in functions.values()} < set(night_nlos.__all__)
    packaged = project["tool"]["setuptools"]
    folders = [name.removesuffix("*") for name in packaged["packages"]["find"]["include"]]
    assert sorted([*packaged["py-modules"], *folders]) == sorted(ROOMS)


@pytest.mark.parametrize(
    ("program", "file"),
    [
        ("night-gen", "cli.py"),
        ("night-render", "render/__init__.py"),
        ("night-train", "model/weights.txt"),  # a folder of data, which Python takes for a package
        ("night-eval", "model.py"),
    ],
)
def test_a_foreign_module_of_our_name_is_named_and_not_run(tmp_path, program, file):
    foreign = tmp_path / "mine" / file
    foreign.parent.mkdir(parents=True)
    foreign.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    done = night(program, "--version", PYTHONPATH=str(tmp_path / "mine"))
    assert (done.returncode, done.stdout) == (2, "")
    named = foreign if file.endswith(".py") else foreign.parent
    assert done.stderr.startswith(f"Error: {named} would be imported in place of NIGHT's own module ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "ran").exists()


def test_one_namespace_leads_through_the_chain():
    assert dir(night_nlos) == sorted(night_nlos.__all__)
    offered = set(dir(night_nlos)) - {"__version__", *(name.replace("-", "_") for name in PROGRAMS)}
    homes = {name: getattr(night_nlos, name).__module__.split(".")[0] for name in offered}
    assert {home: list(homes.values()).count(home) for home in set(homes.values())}.keys() == {
        *("scenegen", "itof", "render", "model")
    }
    for name, home in homes.items():
        assert getattr(import_module(home), name) is getattr(night_nlos, name)
    with pytest.raises(AttributeError, match="no attribute nothing"):
        night_nlos.nothing  # noqa: B018


def test_a_foreign_module_of_our_name_is_named_in_python_too(tmp_path):
    (tmp_path / "model.py").write_text("raise SystemExit('it ran')")
    code = "import night_nlos; night_nlos.load"
    done = shell(f'cd {tmp_path}; exec "$@"', sys.executable, "-c", code)  # which looks there first
    wrong = f"ImportError: {tmp_path / 'model.py'} would be imported in place of"
    assert done.stderr.splitlines()[-1].startswith(wrong)


def test_foreign_modules_of_other_names_do_no_harm(tmp_path):
    (tmp_path / "models.py").write_text("")
    (tmp_path / "data").mkdir()
    done = night("night-gen", "--version", PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")


# Streams


@pytest.mark.long
@pytest.mark.parametrize("closed", ["2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_changes_neither_exit_code_nor_the_other_streams(seven_renders, closed):
    done = shell(f'exec "$@" {closed}', *words("night-render", "status", seven_renders))
    assert done.returncode == 0
    assert done.stdout == "" if " >&-" in f" {closed}" else done.stdout.startswith("7 scenes: ")
    assert done.stderr == ""


def test_nothing_is_printed_into_a_file_that_is_opened_in_place_of_a_closed_stream(tmp_path):
    code = "import os, commandline.streams_and_caches as s; s.prepare_process(); new = open('new', 'w')"
    write = "; print(1); os.write(1, b'x'); os.write(2, b'x')"
    done = shell(f'cd {tmp_path}; exec "$@" <&- >&- 2>&-', sys.executable, "-c", code + write)
    assert done.returncode == 0
    assert (tmp_path / "new").read_bytes() == b""


@pytest.mark.long
def test_a_result_that_cannot_be_printed_is_an_error(seven_renders):
    done = shell(f'exec "$@" >{FULL}', *words("night-render", "status", seven_renders))
    assert done.returncode == 2
    assert (
        done.stderr == "Error: the result could not be printed on standard output: No space left on device\n"
    )
    assert shell(f'exec "$@" >{FULL} 2>{FULL}', *words("night-gen", "--help")).returncode == 2


@pytest.mark.long
def test_messages_that_cannot_be_printed_change_no_exit_code():
    assert shell(f'exec "$@" 2>{FULL}', *words("night-render", "nowhere")).returncode == 2


# Caches and temporary files


@pytest.mark.parametrize("home", [None, "nowhere"])
def test_without_a_home_folder_caches_lie_in_a_private_folder(tmp_path, monkeypatch, home):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("DRJIT_CACHE_DIR", raising=False)
    monkeypatch.setenv("MPLCONFIGDIR", "mine")
    monkeypatch.setenv("HOME", str(tmp_path))
    prepare_process()
    assert "DRJIT_CACHE_DIR" not in os.environ
    monkeypatch.setenv("HOME", str(tmp_path / home)) if home else monkeypatch.delenv("HOME")
    prepare_process()
    private = tmp_path / f"night-{os.getuid()}"
    assert os.environ["DRJIT_CACHE_DIR"] == str(private / "drjit")
    assert os.environ["MPLCONFIGDIR"] == "mine"
    assert stat.S_IMODE(private.stat().st_mode) == 0o700


@pytest.mark.parametrize("taken", ["link", "file", "open folder"])
def test_a_private_folder_is_never_one_that_others_can_write(tmp_path, monkeypatch, taken):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    place = tmp_path / f"night-{os.getuid()}"
    if taken == "link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        place.symlink_to("theirs")
    elif taken == "file":
        place.write_text("")
    else:
        place.mkdir()
        place.chmod(0o777)
    folder = private_folder()
    assert folder != place
    assert folder.parent == tmp_path
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


# All commands


def every_command(folder):
    """Command lines that need all libraries, in an order in which each finds what it needs."""
    (folder / "small.toml").write_text(PRESET)
    data, run = folder / "data", folder / "run"
    scene = data / "renders" / "000000"
    cpu = ("--device", "cpu")
    return [
        words("night-gen", "scenes", data, "--preset", folder / "small.toml"),
        words("night-render", data, "--lights", 64, "--workers", 2, *cpu),
        words("night-render", data, "--dry-run", *cpu),
        words("night-render", "status", data),
        words("night-render", "verify", data, "--workers", 2),
        words("night-render", "movie", data, "000000", "--out", folder / "movie.mp4"),
        words("night-render", "convert", data, "--to", "itof", "--out", folder / "itof"),
        words("night-render", "convert", data, "--to", "tal", "--out", folder / "tal", "--only", "000000"),
        words("night-gen", "preview", data, "--count", 2),
        words("night-train", data, "--out", run, *TRAINING, *cpu),
        words("night-eval", run, data, "--out", folder / "report", *cpu),
        words(  # a network of seconds explains nothing
            *(
                "night-eval",
                "predict",
                run,
                scene / "itof.exr",
                "--out",
                folder / "prediction",
                "--force",
                *cpu,
            )
        ),
        words("night-eval", "export", run, "--out", folder / "model.onnx"),
        words("night-render", "drop-transients", data, "--yes"),
    ]


POOR = (
    'ulimit -n 64; exec env -i PATH=/usr/bin:/bin "$@" <&-',
    'exec env HOME=/proc/nowhere "$@" >&-',
    'exec "$@" 2>&-',
    'exec "$@" <&- >&- 2>&-',
    f'exec "$@" 2>{FULL}',
)


@pytest.mark.long
@pytest.mark.parametrize(
    "lines",
    [
        pytest.param(POOR, id="in turn"),
        *(pytest.param([line], id=line, marks=pytest.mark.thorough) for line in POOR),
    ],
)
def test_every_command_works_in_a_poor_environment_and_leaves_only_caches(tmp_path, monkeypatch, lines):
    (temporary := tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    for command, line in zip(every_command(tmp_path), itertools.cycle(lines), strict=False):
        done = shell(line, *command)
        assert done.returncode == 0, (command, line, done.stdout, done.stderr)
        assert "Traceback" not in done.stdout + done.stderr
        assert not done.stderr or "2>" not in line
        assert {place.name for place in temporary.iterdir()} <= {f"night-{os.getuid()}"}, command


def test_ctrl_c_before_there_is_a_command_ends_the_process_without_a_word():
    while_it_looks = "night_nlos.foreign_module = lambda: os.kill(os.getpid(), signal.SIGINT)"
    then = "import cli; cli.night_gen = lambda: print(signal.getsignal(signal.SIGINT).__name__)"
    for change, code, printed in ((while_it_looks, -signal.SIGINT, ""), (then, 0, "default_int_handler\n")):
        program = f"import night_nlos, os, signal; {change}; night_nlos.night_gen()"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (code, printed, "")
