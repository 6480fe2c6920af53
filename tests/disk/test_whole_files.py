"""Files and folders that appear whole or not at all, and what killed processes leave behind."""

import contextlib
import fcntl
import os
import stat
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from kill_points import FOLDERS, contents, names, write_folder

import disk
from disk import is_partial, remove_leftovers, whole_file, whole_folder, write_text
from disk.partials import HOST

OLD, NEW = FOLDERS
KILLED = """
import os, sys
from pathlib import Path
from disk import whole_{kind}
with whole_{kind}(Path(sys.argv[1])) as partial:
    (partial / "a" if partial.is_dir() else partial).write_text("half")
    os._exit(9)
"""


@pytest.fixture(params=["file", "folder"])
def killed(request, tmp_path):
    """Name and kind of something whose writer was killed."""
    code = KILLED.format(kind=request.param)
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "data"], check=False)
    assert done.returncode == 9
    assert [is_partial(entry.name) for entry in tmp_path.iterdir()] == [True]
    return tmp_path / "data", request.param


def test_the_next_writer_removes_what_a_killed_one_left(killed):
    path, kind = killed
    if kind == "file":
        write_text(path, "whole")
    else:
        with whole_folder(path) as partial:
            (partial / "a").write_text("whole")
    assert [entry.name for entry in path.parent.iterdir()] == ["data"]


def test_what_was_begun_under_another_name_is_left_alone(tmp_path):
    other = leftover(tmp_path, name="data.txt")
    write_text(tmp_path / "data", "whole")
    assert other.exists()


def test_a_folder_is_replaced_with_all_that_is_in_it(tmp_path):
    for content in ("old", "new"):
        with whole_folder(tmp_path / "report") as partial:
            (partial / content / "deep").mkdir(parents=True)
            (partial / content / "deep" / "file").write_text(content)
    assert [str(f.relative_to(tmp_path)) for f in tmp_path.rglob("*")] == [
        *("report", "report/new", "report/new/deep", "report/new/deep/file")
    ]


def test_an_error_leaves_the_older_one(tmp_path):
    for whole in (whole_folder, whole_file):
        path = tmp_path / whole.__name__
        with whole(path) as partial:
            (partial / "a" if partial.is_dir() else partial).write_text("old")
        with pytest.raises(ZeroDivisionError), whole(path) as partial:
            1 / 0  # noqa: B018
        assert (path / "a" if path.is_dir() else path).read_text() == "old"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["whole_file", "whole_folder"]


def test_a_file_is_not_replaced_by_a_folder(tmp_path):
    (tmp_path / "notes").write_text("years of work")
    with pytest.raises(NotADirectoryError, match="notes"), whole_folder(tmp_path / "notes"):
        pass
    assert (tmp_path / "notes").read_text() == "years of work"


def test_a_folder_in_which_nothing_can_be_made_is_given_up():
    with pytest.raises(OSError, match="/proc"), whole_file(Path("/proc/night.txt")):
        pass


def test_what_a_kill_between_two_renames_left_is_safe_from_a_failing_command(tmp_path):
    # The fault that was reported: the old one in a temporary folder, then a command that fails.
    left = tmp_path / f".x.{HOST}-999999999.7.partial"
    (left / "x.old").mkdir(parents=True)
    (left / "x.old" / "a").write_text("old")
    (left / "x").mkdir()
    for _ in range(2):
        with pytest.raises(OSError, match="No space left"), whole_folder(tmp_path / "x"):
            raise OSError(28, "No space left on device")
        assert contents(tmp_path / "x") == {"a": "old"}
        assert names(tmp_path) == ["x"]


def leftover(folder, host=HOST, pid=999999999, number=1, text="half", name="x"):
    partial = folder / f".{name}.{host}-{pid}.{number}.partial"
    partial.mkdir()
    (partial / "x").write_text(text)
    return partial


def test_a_lock_and_not_a_process_id_tells_what_is_in_use(tmp_path):
    reused = leftover(tmp_path, pid=os.getppid())  # a process with this id lives, and it is another one
    ours = leftover(tmp_path, pid=os.getpid(), number=999)
    written = leftover(tmp_path, number=2)  # by a process that this one cannot see, as in another container
    lock = os.open(written, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    remove_leftovers(tmp_path)
    assert [written.exists(), reused.exists(), ours.exists()] == [True, False, False]
    os.close(lock)
    remove_leftovers(tmp_path)
    assert names(tmp_path) == []


def test_without_locks_a_living_process_keeps_its_temporary_files(tmp_path, monkeypatch):
    def unsupported(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", unsupported)
    kept, gone = leftover(tmp_path, pid=os.getppid()), leftover(tmp_path)
    write_text(tmp_path / "x", "whole")
    assert [kept.exists(), gone.exists()] == [True, False]
    assert (tmp_path / "x").read_text() == "whole"


def test_leftovers_of_another_machine_go_after_a_week(tmp_path):
    partial = leftover(tmp_path, host="another_machine")
    (partial / "x.old").mkdir()  # what it was replacing is put back at once
    remove_leftovers(tmp_path)
    assert partial.exists()
    assert contents(tmp_path / "x") == {}
    for file in (partial / "x", partial):
        os.utime(file, (time.time() - 8 * 86400,) * 2)
    remove_leftovers(tmp_path)
    assert names(tmp_path) == ["x"]


def test_leftovers_that_cannot_be_removed_stop_nobody(tmp_path, monkeypatch):
    kept = leftover(tmp_path)
    (kept / "x.old").mkdir()

    def forbidden(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.rename", forbidden)
    write_text(tmp_path / "y", "whole")
    remove_leftovers(tmp_path)
    assert (kept / "x.old").is_dir()  # it could not get its name back, so it stays where it is
    assert (tmp_path / "y").read_text() == "whole"


@pytest.mark.long
def test_readers_find_the_folder_while_two_threads_replace_it(tmp_path):
    texts = [{"a": text, "b": text} for text in "123"]
    write_folder(tmp_path / "x", texts[2])

    def write(text):
        for _ in range(10):
            write_folder(tmp_path / "x", text)

    with ThreadPoolExecutor(2) as pool:
        writing = [pool.submit(write, text) for text in texts[:2]]
        while not all(future.done() for future in writing):
            assert (tmp_path / "x").is_dir()
        assert [future.result() for future in writing] == [None, None]
    assert contents(tmp_path / "x") in texts[:2]
    assert names(tmp_path) == ["x"]


def test_a_name_that_another_process_takes_between_two_steps_is_taken_back(tmp_path, monkeypatch):
    path, rename, taken = tmp_path / "x", Path.rename, []

    def racing(self, target):
        if target == path and not taken:  # the older one has just been moved away
            path.mkdir()
            (path / "theirs").write_text("theirs")
            taken.append(True)
        return rename(self, target)

    write_folder(path, OLD)
    monkeypatch.setattr("disk.whole_writing.exchange", lambda *_: False)
    monkeypatch.setattr("pathlib.Path.rename", racing)
    write_folder(path, NEW)
    assert taken
    assert contents(path) == NEW
    assert names(tmp_path) == ["x"]


def test_a_link_is_replaced_and_what_it_leads_to_is_kept(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a").write_text("mine")
    (tmp_path / "folder").symlink_to("elsewhere")
    (tmp_path / "file").symlink_to("elsewhere/a")
    (tmp_path / "nowhere").symlink_to("missing")
    write_folder(tmp_path / "folder", NEW)
    write_text(tmp_path / "file", "new")
    write_folder(tmp_path / "nowhere", NEW)
    assert contents(tmp_path / "elsewhere") == {"a": "mine"}
    assert contents(tmp_path / "folder") == contents(tmp_path / "nowhere") == NEW
    assert not any(entry.is_symlink() for entry in tmp_path.iterdir())


def test_what_cannot_be_replaced_is_refused_before_the_work(tmp_path, monkeypatch):
    folder, file = tmp_path / "folder", tmp_path / "file"
    folder.mkdir()
    file.touch()
    with pytest.raises(IsADirectoryError, match="folder"), whole_file(folder):
        pytest.fail("the work was done")
    with pytest.raises(OSError, match="mount point"), whole_folder("/proc"):
        pytest.fail("the work was done")
    with pytest.raises(NotADirectoryError, match="file'"), whole_file(file / "b"):
        pytest.fail("the work was done")
    monkeypatch.setattr(os, "access", lambda *_: False)  # as for a user other than root
    with pytest.raises(PermissionError, match="folder"), whole_folder(folder):
        pytest.fail("the work was done")


def test_a_failed_write_names_the_final_file(tmp_path):
    path = tmp_path / "deep" / "x"
    with pytest.raises(OSError, match="No space left on device") as caught, whole_file(path):
        raise OSError(28, "No space left on device")  # as from a stream, which has no name
    assert caught.value.filename == str(path)
    with pytest.raises(FileNotFoundError) as caught, whole_file(path) as partial:
        (partial / "y").read_bytes()
    assert caught.value.filename == str(path)
    with pytest.raises(FileNotFoundError) as caught, whole_file(path):
        (tmp_path / "another").read_bytes()
    assert caught.value.filename == str(tmp_path / "another")


def test_a_file_gets_the_permissions_that_the_umask_allows(tmp_path):
    before = os.umask(0o027)
    try:
        with whole_file(tmp_path / "x") as partial:
            partial.touch(mode=0o600)  # as libraries do that write to a temporary file of their own
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == 0o640


def test_paths_may_be_text_and_relative(tmp_path):
    with contextlib.chdir(tmp_path):
        write_text("a", "1")
        with whole_file("b/c") as partial:
            partial.write_text("2")
        with whole_folder("d") as partial:
            (partial / "e").write_text("3")
        remove_leftovers(".", "a")
    assert contents(tmp_path) == {"a": "1", "b/c": "2", "d/e": "3"}


def test_a_text_may_name_a_file_that_is_not_utf_8(tmp_path):
    write_text(tmp_path / "a", os.fsdecode(b"\xc3\xa9 \xff"))
    assert (tmp_path / "a").read_bytes() == b"\xc3\xa9 \\udcff"


def test_files_that_belong_together_appear_together_or_not_at_all(tmp_path):
    (tmp_path / "a").write_text("old")
    (tmp_path / "c").write_text("other")
    seen = []

    def write(fail):
        with disk.whole_files(tmp_path, before=lambda: seen.append((tmp_path / "a").read_text())) as stage:
            for name in ("a", "b"):
                write_text(stage / name, "new")
            if fail:
                raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write(fail=True)
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {"a": "old", "c": "other"}
    write(fail=False)
    assert seen == ["old"]
    texts = {file.name: file.read_text() for file in tmp_path.iterdir()}
    assert texts == {"a": "new", "b": "new", "c": "other"}


def test_an_error_in_a_file_of_several_names_its_place(tmp_path):
    def write():
        with disk.whole_files(tmp_path / "out") as stage:
            (stage / "a").mkdir()
            write_text(stage / "a", "new")

    with pytest.raises(IsADirectoryError) as caught:
        write()
    assert caught.value.filename == str(tmp_path / "out" / "a")
