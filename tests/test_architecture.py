"""The shape of the house (STYLE 1 and 5): arrows go one way, and importing does nothing."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import itof
from scenegen import preset

ROOT = Path(__file__).parent.parent
OURS = ("scenegen", "itof", "render", "model", "cli")
MAY_IMPORT = {
    "scenegen": set(),
    "itof": set(),
    "render": {"scenegen", "itof"},
    "model": {"scenegen", "itof"},
    "cli": {"scenegen", "itof", "render", "model"},
}
# Libraries that live in one place: where each may be imported.
HOME = {
    "mitsuba": "render/",
    "drjit": "render/",
    "mitransient": "render/",
    "torch": "model/",
    "click": "cli.py",
    "bpy": "scenegen/making/blender.py",
    "bmesh": "scenegen/making/blender.py",
    "mathutils": "scenegen/making/blender.py",
    "OpenEXR": "itof/exr.py",
    "Imath": "itof/exr.py",
    "h5py": ("render/products/tal_export.py", "model/prediction/measurement_files.py"),
    "imageio_ffmpeg": "render/products/movie.py",
}


def sources():
    files = [ROOT / "cli.py"]
    for package in OURS[:-1]:
        files += sorted((ROOT / package).rglob("*.py"))
    return {str(file.relative_to(ROOT)): ast.parse(file.read_text()) for file in files}


def imported_modules(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield node.module


def imports_of_blender(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        if "scenegen.making.blender" in names:
            yield node


def test_imports_follow_the_arrows():
    wrong = [
        f"{file} imports {module}"
        for file, tree in sources().items()
        for module in imported_modules(tree)
        if (target := module.split(".")[0]) in OURS
        and target != (own := file.split("/")[0].removesuffix(".py"))
        and target not in MAY_IMPORT[own]
    ]
    assert wrong == []


def test_each_heavy_library_lives_in_its_one_place():
    wrong = [
        f"{file} imports {module}"
        for file, tree in sources().items()
        for module in imported_modules(tree)
        if not file.startswith(HOME.get(module.split(".")[0], ""))
    ]
    assert wrong == []


def test_the_blender_file_is_imported_late_and_by_night_gen_alone():
    users = [(file, node.col_offset) for file, tree in sources().items() for node in imports_of_blender(tree)]
    assert [file for file, _ in users] == ["cli.py"]
    assert users[0][1] > 0  # inside a function


@pytest.mark.parametrize(
    "line",
    [
        "import scenegen.making.blender",
        "from scenegen import Scene, blender",
        "import os, scenegen.making.blender as maker",
        "from scenegen.making.blender import BlenderMaker",
    ],
)
def test_every_way_to_import_the_blender_file_is_seen(line):
    assert len(list(imports_of_blender(ast.parse(line)))) == 1


def test_both_packages_that_need_the_speed_of_light_mean_the_same():
    assert preset.SPEED_OF_LIGHT == itof.SPEED_OF_LIGHT


@pytest.mark.parametrize("llvm", ["in ldconfig", "in DRJIT_LIBLLVM_PATH"])
def test_a_machine_with_all_libraries_is_always_found_complete(tmp_path, llvm):
    # So many libraries that ldconfig is still writing when the first match is found.
    names = re.findall(r"^lib\S+", (ROOT / ".ci/system_libraries").read_text(), re.MULTILINE)
    if llvm == "in ldconfig":
        names.append("libLLVM.so.19.1")
    listing = "".join(f"\t{name} (libc6) => /lib/{name}\n" for name in names)
    (tmp_path / "listing").write_text(listing + "\tlibother.so.1 (libc6) => /lib/x\n" * 50_000)
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


@pytest.mark.parametrize("package", OURS)
def test_importing_does_nothing_but_import(package, tmp_path):
    heavy = {"mitsuba", "drjit", "bpy", "mitransient"} | ({"torch"} if package != "model" else set())
    code = f"import sys, {package}; print(sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        env={"PATH": "", "HOME": str(tmp_path), "MPLCONFIGDIR": str(tmp_path / "mpl")},
    )
    assert done.stdout == "[]\n"
    assert done.stderr == ""
    assert {entry.name for entry in tmp_path.iterdir()} <= {"mpl"}


@pytest.mark.parametrize("package", OURS[:-1])
def test_a_package_says_what_it_offers(package):
    tree = sources()[f"{package}/__init__.py"]
    assert ast.get_docstring(tree)
    names = next(
        [element.value for element in node.value.elts]
        for node in tree.body
        if isinstance(node, ast.Assign) and node.targets[0].id == "__all__"
    )
    imported = [alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert sorted(names) == sorted(imported)
