"""Files and folders that appear whole or not at all, and what killed processes leave behind."""

import os
import subprocess
import sys

import pytest

from scenegen import is_partial, whole_file, whole_folder, write_text
from scenegen.files.whole_files import HOST

KILLED = """
import os, sys
from pathlib import Path
from scenegen import whole_{kind}
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


def test_what_a_living_process_writes_is_left_alone(tmp_path):
    living = tmp_path / f".data.{HOST}-{os.getppid()}.partial"
    living.write_text("half")
    elsewhere = tmp_path / ".data.another_machine-999999999.partial"
    elsewhere.write_text("half")
    other = tmp_path / f".data.txt.{HOST}-999999999.partial"  # of another name
    other.write_text("half")
    write_text(tmp_path / "data", "whole")
    assert living.exists()
    assert elsewhere.exists()
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
