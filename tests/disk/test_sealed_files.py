"""Sets of files whose seal says that they are whole, also after a kill or a power failure."""

import itertools
import os
import threading
from pathlib import Path

from kill_points import EVENTS, killed_before

from disk.sealed_files import SealedFiles, write_sealed


def sealed(folder, text):
    """A set of two files and a seal, which all have the same contents."""
    data = text.encode()
    return SealedFiles(folder, {"a": data, "b": data}, ("seal", data), lambda: forget(folder))


def forget(folder):
    (folder / "seal").unlink(missing_ok=True)


def texts(folder):
    return {file.name: file.read_text() for file in folder.iterdir() if file.is_file()}


def test_sets_appear_in_their_folders_and_leave_what_is_not_theirs(tmp_path):
    (tmp_path / "0").mkdir()
    (tmp_path / "0" / "c").write_text("other")
    assert (
        write_sealed([sealed(tmp_path / str(number), f"text {number}") for number in range(100)])
        == [None] * 100
    )
    for number in range(100):
        other = {"c": "other"} if number == 0 else {}
        assert texts(tmp_path / str(number)) == dict.fromkeys(("a", "b", "seal"), f"text {number}") | other
    assert {entry.name for entry in (tmp_path / "0").iterdir()} == {"a", "b", "c", "seal"}
    assert write_sealed([]) == []


def test_a_seal_is_never_beside_files_that_are_not_whole_whenever_the_writer_is_killed(tmp_path):
    folders = [tmp_path / "0", tmp_path / "1"]
    for number in itertools.count():
        write_sealed([sealed(folder, "old") for folder in folders])
        new = [sealed(folder, "new") for folder in folders]
        if not killed_before(number, EVENTS, lambda: write_sealed(new), tmp_path):  # noqa: B023
            break
        for folder in folders:
            left = texts(folder)
            assert set(left.values()) <= {"old", "new"}
            assert "seal" not in left or left["a"] == left["b"] == left["seal"]
        write_sealed(new)  # removes what the killed one left
        assert [sorted(entry.name for entry in folder.iterdir()) for folder in folders] == [
            ["a", "b", "seal"]
        ] * 2
    assert number > 10


def test_what_a_seal_vouches_for_is_on_disk_before_the_seal_has_its_name(tmp_path, monkeypatch):
    done, lock = [], threading.Lock()

    def noted(function, what):
        def call(*given):
            result = function(*given)
            with lock:
                done.append(what(*given))
            return result

        return call

    monkeypatch.setattr(
        os, "fsync", noted(os.fsync, lambda fd: ("on disk", str(Path(f"/proc/self/fd/{fd}").readlink())))
    )
    monkeypatch.setattr(os, "replace", noted(os.replace, lambda old, new: ("named", str(old), str(new))))
    folders = [tmp_path / str(number) for number in range(3)]
    assert write_sealed([sealed(folder, "text") for folder in folders]) == [None] * 3
    for folder in folders:
        named = {
            Path(each[2]).name: each for each in done if each[0] == "named" and Path(each[2]).parent == folder
        }
        names_on_disk = [place for place, each in enumerate(done) if each == ("on disk", str(folder))]
        for name in ("a", "b", "seal"):
            assert done.index(("on disk", named[name][1])) < done.index(named["a"])
        assert done.index(named["b"]) < names_on_disk[0] < done.index(named["seal"]) < names_on_disk[1]
        assert ("on disk", str(tmp_path)) in done[: done.index(named["seal"])]


def test_a_set_that_cannot_be_written_names_its_place_and_the_others_are_written(tmp_path):
    (tmp_path / "0").write_text("in the way")
    (tmp_path / "2" / "b").mkdir(parents=True)
    (tmp_path / "2" / "seal").write_text("old")
    found = write_sealed([sealed(tmp_path / str(number), "text") for number in range(4)])
    assert [getattr(error, "filename", None) for error in found] == [
        *(str(tmp_path / "0"), None, str(tmp_path / "2" / "b"), None)
    ]
    assert texts(tmp_path / "1") == texts(tmp_path / "3") == dict.fromkeys(("a", "b", "seal"), "text")
    assert texts(tmp_path / "2") == {"seal": "old"}
