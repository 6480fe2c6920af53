"""The search for the machine's libraries, `.ci/system_libraries`."""

import os
import re
import subprocess

import pytest
from source_tree import ROOT


@pytest.mark.parametrize("llvm", ["in ldconfig", "in DRJIT_LIBLLVM_PATH"])
def test_a_machine_with_all_libraries_is_always_found_complete(tmp_path, llvm):
    names = re.findall(r"^lib\S+", (ROOT / ".ci/system_libraries").read_text(), re.MULTILINE)
    if llvm == "in ldconfig":
        names.append("libLLVM.so.19.1")
    listing = "".join(f"\t{name} (libc6) => /lib/{name}\n" for name in names)
    (tmp_path / "listing").write_text(listing)
    for program, line in (("ldconfig", f"cat {tmp_path}/listing"), ("python-stub", "exit 0")):
        (tmp_path / program).write_text(f"#!/bin/sh\n{line}\n")
        (tmp_path / program).chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHON": "python-stub"}
    if llvm == "in DRJIT_LIBLLVM_PATH":
        environment["DRJIT_LIBLLVM_PATH"] = str(tmp_path / "listing")
    for installer in ("apt-get", "sudo"):  # must not be reached
        (tmp_path / installer).write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / installer).chmod(0o755)
    done = subprocess.run(
        ["bash", ROOT / ".ci/system_libraries"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
