"""`inside`: a path that is put together from the text of a file cannot leave its folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from disk import NightError, inside


@pytest.mark.parametrize(
    "part", ["", ".", "/", "/etc/passwd", "..", "x/../../../victim", "../x", "a/..", "a\0b", "\ud800", "//x"]
)
def test_the_text_of_a_path_cannot_leave_its_folder(tmp_path: Path, part: str) -> None:
    for parts in [(part,), ("scenes", part), (part, "scene.json")]:
        with pytest.raises(NightError, match=r"inside|empty") as refused:
            inside(tmp_path, *parts)
        assert str(tmp_path) in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_path_inside_its_folder_is_joined(tmp_path: Path) -> None:
    assert inside(tmp_path, "scenes", "000001") == tmp_path / "scenes" / "000001"
    assert inside(tmp_path, "./meshes//bunny.ply") == tmp_path / "meshes" / "bunny.ply"
    assert inside(Path("relative"), "..x") == Path("relative/..x")
    with pytest.raises(NightError, match="empty"):
        inside(tmp_path)


@pytest.mark.parametrize("target", ["{out}", "{out}/file", "../..", "{out}/missing", "."])
def test_a_symbolic_link_cannot_leave_its_folder(tmp_path: Path, target: str) -> None:
    root, outside = tmp_path / "root", tmp_path / "out"
    root.mkdir()
    outside.mkdir()
    (outside / "file").write_text("victim")
    (root / "link").symlink_to(target.format(out=outside))
    for parts in [("link",), ("link", "below")]:
        if target == "." and len(parts) == 2:
            assert inside(root, *parts) == root / "link" / "below"
            continue
        with pytest.raises(NightError, match="symbolic link") as refused:
            inside(root, *parts)
        assert str(root / "link") in str(refused.value)


def test_a_symbolic_link_within_the_folder_and_a_linked_root_are_allowed(tmp_path: Path) -> None:
    root, linked = tmp_path / "root", tmp_path / "linked"
    (root / "real").mkdir(parents=True)
    (root / "link").symlink_to("real")
    linked.symlink_to(root)
    assert inside(root, "link", "x") == root / "link" / "x"
    assert inside(linked, "link", "x") == linked / "link" / "x"
    assert inside(linked, "real") == linked / "real"


def test_a_link_of_links_and_a_loop_of_links_do_not_leave_the_folder(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (root / "first").symlink_to("second")
    (root / "second").symlink_to(tmp_path)
    with pytest.raises(NightError, match="symbolic link"):
        inside(root, "first", "x")
    (root / "loop").symlink_to("loop")
    assert inside(root, "loop", "x") == root / "loop" / "x"  # opening it is an OSError
