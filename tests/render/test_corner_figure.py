"""The picture of a corner, and the distances that it says, without any scene."""

import json

import numpy as np
import pytest
from night_commands import night_here, refusal

from render.products.corner_figure import corner_facts
from scenegen import load_preset, preset_from_dict


def test_the_facts_of_the_corner_of_the_paper_are_those_of_its_geometry():
    facts = corner_facts(load_preset("paper"))
    assert (facts.camera_m, facts.gap_m) == pytest.approx((1.0, 0.7))
    assert facts.region_m == pytest.approx((1.0, 1.3))
    assert (facts.relay_wall, facts.middle_wall, facts.nothing) == (1, 0, 0)
    # The camera is 1 m away and sees 10 to 70 degrees beside the normal, less half a ray at the far end.
    reach_m = np.tan(np.radians(70)) - np.tan(np.radians(10))
    assert facts.lit_m[1] == pytest.approx(reach_m, rel=0.01)


@pytest.mark.parametrize(("roll_deg", "size"), [(0.0, (40, 30)), (90.0, (30, 40))])
def test_shares_of_the_image_are_those_of_the_rays(roll_deg, size):
    """It looks along the relay wall; the edge of the middle wall is 1 m ahead and 0.3 m to the left."""
    half = np.tan(np.radians(30.0))
    view_deg = np.degrees(2 * np.arctan(half * min(1, size[0] / size[1])))
    camera = {"horizontal_fov_deg": view_deg, "rotation_deg": [90.0, roll_deg, 0.0]}
    tables = {"camera": camera | dict(zip(("width", "height"), size, strict=True))}
    facts = corner_facts(preset_from_dict(tables, "test"))
    share = (half - 0.3) / (2 * half)
    assert facts.relay_wall == pytest.approx(share, abs=1 / 300)
    assert facts.middle_wall == pytest.approx(1 - share, abs=1 / 300)


def test_a_camera_that_looks_past_the_edge_of_a_wall_sees_nothing_there():
    small = {"size_m": [0.5, 0.5], "location_m": [0.0, -0.2, 1.65]}
    facts = corner_facts(
        preset_from_dict({"relay_wall": small, "middle_wall": {"size_m": [0.1, 0.1]}}, "test")
    )
    assert 0.3 < facts.nothing < 0.99
    assert facts.relay_wall + facts.middle_wall + facts.nothing == pytest.approx(1)


def test_a_middle_wall_that_touches_the_relay_wall_leaves_no_gap():
    facts = corner_facts(preset_from_dict({"middle_wall": {"location_m": [1.65, 0.0, 2.0]}}, "test"))
    assert "the middle wall reaches 0.00 m behind the plane of the relay wall" in facts.sentences


def test_the_command_draws_a_corner_and_refuses_one_that_cannot_be_after_that(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = night_here("night-gen", "corner", "paper", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["gap_m"] == pytest.approx(0.7)
    assert "of the image, 100 % show the relay wall, 0 % the middle wall, 0 % nothing" in done.stderr
    (tmp_path / "closed.toml").write_text("[middle_wall]\nlocation_m = [1.6, 0.0, 2.0]\n")
    refused = night_here("night-gen", "corner", "closed.toml", "--out", "picture.png")
    assert refused.returncode == 2
    assert "the middle wall reaches 0.05 m behind the plane of the relay wall" in refused.stdout
    assert "the middle wall crosses the relay wall" in refused.stderr
    assert "is a .png file" in refusal("night-gen", "corner", "paper", "--out", "closed.toml")
    pictures = {file.name for file in tmp_path.iterdir() if file.read_bytes().startswith(b"\x89PNG")}
    assert pictures == {"paper_corner.png", "picture.png"}
