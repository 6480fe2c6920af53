"""The picture of a corner, and the distances that it says, without any scene."""

import json
import re

import numpy as np
import pytest
from night_commands import night_here, refusal
from report_pages import Page, browse, needs_chromium

from render.batch.expected_light import ExpectedLight, expected_light
from render.batch.light import LightImages
from render.products.corner_facts import corner_facts
from render.products.corner_page import write_corner_page
from scenegen import load_preset, preset_from_dict


def test_the_facts_of_the_corner_of_the_paper_are_those_of_its_geometry():
    facts = corner_facts(load_preset("paper"))
    assert (facts.camera_m, facts.gap_m) == pytest.approx((1.0, 0.7))
    assert facts.region_m == pytest.approx((1.0 - 0.12, 1.3 + 0.15))  # with the second shapes of composites
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
    assert 0 < facts.nothing < 1
    assert facts.relay_wall + facts.middle_wall + facts.nothing == pytest.approx(1)


def test_a_middle_wall_that_touches_the_relay_wall_leaves_no_gap():
    facts = corner_facts(preset_from_dict({"middle_wall": {"location_m": [1.65, 0.0, 2.0]}}, "test"))
    assert "the middle wall touches the plane of the relay wall" in facts.sentences


def test_objects_beside_others_are_in_the_region_too():
    beside = {"shape": "cube", "size_m": 0.2, "offset_m": {"x": 0.5}}
    cube = {"shape": "cube", "size_m": 0.2, "beside": [beside]}
    facts = corner_facts(preset_from_dict({"object": [cube]}, "test"))
    assert facts.region_m == pytest.approx((1.0, 1.8))  # of the preset: 1.0 to 1.3


def test_the_command_draws_a_corner_and_refuses_one_that_cannot_be_after_that(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = night_here("night-gen", "corner", "paper", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["gap_m"] == pytest.approx(0.7)
    assert len(told["hidden_light"]["shares"]) == 12
    assert "hidden light: 0.1" in done.stderr
    assert {file.name for file in tmp_path.iterdir()} == {"paper_corner.png", "paper_corner.html"}
    assert "of the image, 100 % show the relay wall, 0 % the middle wall, 0 % nothing" in done.stderr
    (tmp_path / "closed.toml").write_text("[middle_wall]\nlocation_m = [1.6, 0.0, 2.0]\n")
    refused = night_here("night-gen", "corner", "closed.toml", "--out", "picture.png")
    assert refused.returncode == 2
    assert "the middle wall reaches 0.05 m behind the plane of the relay wall" in refused.stdout
    assert "the middle wall crosses the relay wall" in refused.stderr
    assert "must end in .png or .html" in refusal("night-gen", "corner", "paper", "--out", "closed.toml")
    pictures = {file.name for file in tmp_path.iterdir() if file.read_bytes().startswith(b"\x89PNG")}
    assert pictures == {"paper_corner.png", "picture.png"}


def test_the_picture_may_be_a_page_that_loads_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = night_here("night-gen", "corner", "paper", "--out", "corner.html")
    assert done.returncode == 0, done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["corner.html"]
    page = Page((tmp_path / "corner.html").read_text())
    assert page.references == ["data:,"]
    assert page.policy.startswith("default-src 'none'")
    facts = corner_facts(load_preset("paper"))
    said = page.data["corner-data"]["facts"]
    assert said[: len(facts.sentences)] == list(facts.sentences)
    assert [each.split()[0] for each in said[len(facts.sentences) :]] == ["hidden", "a", "`night-train"]
    network = re.fullmatch(
        r"a network: after 3 minutes an MAE of about (.*) cm, after 44 minutes .* (.*) cm, .*: (.*) cm\)",
        said[-2],
    )
    soon, later, no_object = map(float, network.groups())
    assert (soon, later) == pytest.approx((0.266 * no_object, 0.182 * no_object), abs=0.1)
    assert no_object == pytest.approx(8.4, abs=3)  # of 269 scenes, by the docs; 12 scatter
    gap, *_ = (each for each in page.data["corner-data"]["distances"] if "gap" in each["words"])
    assert np.linalg.norm(np.subtract(*gap["ends"])) == pytest.approx(facts.gap_m, abs=1e-4)  # as written
    lit = next(part for part in page.data["corner-data"]["parts"] if part["name"] == "seen and lit")
    assert np.ptp(lit["points"], axis=0)[1] == pytest.approx(facts.lit_m[1], abs=1e-4)


@needs_chromium
def test_a_browser_draws_the_page_without_an_error(tmp_path):
    file, preset = tmp_path / "corner.html", load_preset("paper")
    facts = corner_facts(preset)
    write_corner_page(preset, facts, facts.sentences, file)
    parts = Page(file.read_text()).data["corner-data"]["parts"]
    document, console = browse(file, tmp_path)
    assert console == []
    assert [document.count(tag) for tag in ("<li>", "<label>")] == [len(facts.sentences), len(parts)]
    assert f'data-drawn="{sum(len(part["faces"]) for part in parts)}"' in document


def test_the_share_and_the_turn_of_hidden_light_have_closed_forms():
    """Of light h beside 1, the part in quadrature turns the phase."""
    hz, shape = (20e6, 50e6), (3, 4, 5, 2)
    hidden = np.full(shape, 0.003 + 0.004j, np.complex64)
    hidden[..., 0] = 0.002  # in phase at 20 MHz
    direct = np.ones(shape, np.complex64)
    direct[2] = 0  # this camera sees no wall
    found = ExpectedLight.of_images(LightImages(direct, hidden, np.ones(shape[:3]), np.zeros(3)), hz)
    assert found.no_object_m == 1
    assert found.shares == pytest.approx((0.005, 0.005))
    assert found.turns_rad == pytest.approx((0, np.arctan2(0.004, 1.003)), abs=1e-6)
    assert "0.5 % of the direct light, 0.5 to 0.5 in 2 drawn scenes" in found.sentence


def test_the_hidden_light_to_expect_is_that_of_the_scenes(paper):
    """The docs have 0.02 to 0.44 % for its shapes; three bounces return a tenth of it from darker objects."""
    found = expected_light(paper, device="cpu")
    assert len(found.shares) == 12
    assert 2e-4 < min(found.shares) <= max(found.shares) < 4.4e-3
    dark = expected_light(preset_from_dict({"hidden_object": {"reflectance": 0.1}}, "test"), device="cpu")
    np.testing.assert_allclose(np.array(found.shares) / dark.shares, 10, rtol=1e-5)  # float32 sums


def test_where_the_engine_cannot_render_the_light_is_not_guessed():
    elsewhere = {"projector": {"location_m": [1.0, -1.1, 1.65]}}
    assert expected_light(preset_from_dict(elsewhere, "test"), device="cpu") is None
