"""How many cores a process has."""

import os

from source_tree import ROOT, files

from processes.cores import usable_cores


def test_only_cores_that_this_process_may_run_on_are_counted(monkeypatch):
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert usable_cores() == 1
    finally:
        os.sched_setaffinity(0, before)
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS
    assert usable_cores() == os.cpu_count()


def test_no_other_module_asks_the_system_in_a_way_that_macos_lacks():
    assert [file for file in files() if "sched_getaffinity" in (ROOT / file).read_text()] == [
        "processes/cores.py"
    ]
