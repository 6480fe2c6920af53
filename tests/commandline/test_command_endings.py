"""The sentences of errors of the system: they name the file and say what to do."""

import logging
import os
from errno import EACCES, EDQUOT, EMFILE, ENOENT, ENOMEM, ENOSPC, EROFS
from resource import RLIMIT_NOFILE, getrlimit

import pytest
from night_commands import night_here, refusal

import commandline.evaluation
import commandline.rendering
import commandline.scenes
import commandline.training
from disk import NightError


def fail_with(monkeypatch, error):
    """Let all commands with a dataset fail as they open it."""

    def fail(*_):
        raise error

    for module in (commandline.scenes, commandline.rendering, commandline.evaluation, commandline.training):
        monkeypatch.setattr(module, "open_dataset", fail)


@pytest.mark.parametrize(
    ("code", "filename", "sentence"),
    [
        (ENOSPC, "x.exr", "no space left on the disk of x.exr: free some space and start again"),
        (ENOSPC, None, "no space left on the disk of data: free some space and start again"),
        (ENOSPC, 5, "no space left on the disk of data: free some space and start again"),
        (EDQUOT, b"x.exr", "your quota on the disk of x.exr is used up: free some space and start again"),
        (EACCES, "x", "x: Permission denied: change its permissions (chmod), or give another place"),
        (EROFS, "x", "x: Read-only file system: make it writable, or give another place"),
        (ENOENT, "x", "x: No such file or directory"),
        (ENOMEM, None, "out of memory (Cannot allocate memory): close other programs, or use a machine"),
    ],
)
def test_an_error_of_the_system_names_the_file_and_says_what_to_do(monkeypatch, code, filename, sentence):
    error = OSError(code, os.strerror(code), filename)
    fail_with(monkeypatch, error)
    assert refusal("night-render", "status", "data").startswith(sentence)


def test_an_error_without_a_file_names_the_output_of_the_command(monkeypatch):
    fail_with(monkeypatch, OSError(ENOSPC, os.strerror(ENOSPC)))
    assert "on the disk of run: free" in refusal("night-train", "data", "--out", "run")
    assert "on the disk of data: free" in refusal("night-render", "data")


def test_too_many_open_files_are_told_with_their_limit(monkeypatch):
    fail_with(monkeypatch, OSError(EMFILE, os.strerror(EMFILE), "x"))
    limit = getrlimit(RLIMIT_NOFILE)[0]
    sentence = refusal("night-render", "status", "data")
    assert sentence == f"x: Too many open files: raise the limit of {limit} (ulimit -n) and start again"


def test_a_command_shows_its_own_log_and_of_libraries_only_what_is_wrong(monkeypatch):
    def open_dataset(_):
        for name in ("fontTools.subset", "render.run"):
            logging.getLogger(name).info("%s says something", name)
            logging.getLogger(name).warning("%s warns", name)
        raise NightError("the end")

    monkeypatch.setattr(commandline.rendering, "open_dataset", open_dataset)
    shown = night_here("night-render", "status", "data").stderr.splitlines()
    assert shown == [
        *("fontTools.subset warns", "render.run says something", "render.run warns", "Error: the end")
    ]


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        (("night-render", "data"), "use a smaller --resolution or fewer --workers"),
        (("night-render", "verify", "data"), "use fewer --workers"),
        (("night-render", "status", "data"), "close other programs, or use a machine with more memory"),
        (("night-train", "data", "--out", "run"), "use a smaller --batch-size or --width"),
        (
            ("night-eval", "run", "data", "--out", "o"),
            "close other programs, or use a machine with more memory",
        ),
    ],
)
def test_the_advice_when_memory_runs_out_fits_the_command(monkeypatch, words, advice):
    for error, found in (
        (MemoryError(), "out of memory"),
        (MemoryError("Unable to allocate 21.8 TiB"), "out of memory (Unable to allocate 21.8 TiB)"),
    ):
        fail_with(monkeypatch, error)
        assert refusal(*words) == f"{found}: {advice}"
