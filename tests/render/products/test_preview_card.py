"""The dataset card: its numbers, its snippet of code, its licence."""

import hashlib
import json
import re
import subprocess
import sys
from dataclasses import replace

import pytest
import yaml
from previews import grey_view

from render.products.card import CardError, EarlierCard, checked_licence, dataset_card, read_card
from render.products.croissant import CROISSANT_FILE, croissant, has_no_other_croissant
from render.products.distributions import balance_sentence, read_distributions
from render.products.preview import check_preview, write_preview
from scenegen import Dataset, RenderingRecord, open_dataset, write_rendering_record
from scenegen.dataset import MEASURED_GENERATOR
from scenegen.preset import CameraSpread


def test_the_cards_numbers_are_the_datasets(corners):
    rendering = RenderingRecord(
        method="many-light",
        product="itof",
        max_bounces=3,
        options={"lights": 64, "error": 0.01, "spp": None},
        width=24,
        height=18,
        packages={"mitsuba": "3.9.9"},
        scene_count=3,
        hidden_error_median=0.0123,
        hidden_error_max=0.0456,
    )
    write_rendering_record(corners.renders, rendering)
    dataset = open_dataset(corners.root)
    found = read_distributions(dataset, lambda: None)
    card = dataset_card(dataset, found, None)
    assert card.split("---\n")[2].startswith("\n# corners\n")
    assert "9 synthetic look-behind-a-corner scenes, 3 of them rendered" in card
    for name in sorted({entry.object_class for entry in dataset.index.scenes}):
        members = [entry.split for entry in dataset.index.scenes if entry.object_class == name]
        counts = [members.count(split) for split in ("train", "validation", "test")]
        assert f"| {name} | {counts[0]} | {counts[1]} | {counts[2]} | {len(members)} |" in card
    assert "24 x 18 pixels asked for, 24 x 18 rendered" in card
    assert "1400 bins of 0.01 m" in card
    assert "median 1.23%, at most 4.56%" in card
    assert "method many-light (lights 64, error 0.01), product itof" in card
    assert "mitsuba 3.9.9" in card
    assert balance_sentence(found) in card
    size = sum(f.stat().st_size for f in (corners.root / "renders").rglob("*") if f.is_file())
    unit = 1000 if size < 999_500 else 1_000_000
    assert f"renders {size / unit:.3g} {'kB' if unit == 1000 else 'MB'}" in card
    assert "preset key `transient.bin_count` | `1400`" in card
    assert "preset key `dataset.seed` | `3`" in card
    # The preset has values of three origins, so the card does not say that they are all the paper's.
    assert "have the value of the preset `paper`" in card
    assert "the value of the paper;" not in card
    assert "No licence has been chosen yet" in card
    assert str(corners.root.parent) not in card
    assert not re.search(r"\s/\w", card)  # no absolute path


def test_the_cards_snippet_runs_in_the_datasets_folder(corners):
    card = dataset_card(corners, read_distributions(corners, lambda: None), None)
    snippet = re.search(r"```python\n(.*?)```", card, re.DOTALL)[1]
    check = "\nassert z.shape == (18, 24, 3) and wall_depth_m.shape == hidden_depth_m.shape == (18, 24)"
    command = [sys.executable, "-c", snippet + check]
    done = subprocess.run(command, cwd=corners.root, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# The third would end the comment that holds it.
@pytest.mark.parametrize("licence", ["CC BY 4.0", "CC-BY-SA 4.0 | ours", "a --> b -- c"])
def test_a_licence_is_read_from_the_card_that_names_it(corners, licence):
    card = dataset_card(corners, read_distributions(corners, lambda: None), licence)
    assert f"## Licence\n\n{licence}\n" in card
    assert len(re.findall("-->", card.split("## Licence")[0])) == 1
    (corners.root / "README.md").write_text(card)
    assert read_card(corners).licence == licence


@pytest.mark.long
def test_a_licence_is_kept_until_another_is_given(corners):
    card = dataset_card(corners, read_distributions(corners, lambda: None), "CC BY 4.0")
    (corners.root / "README.md").write_text(card)
    write_preview(corners, ["000002"], grey_view)
    assert (corners.root / "README.md").read_text() == card
    write_preview(corners, ["000002"], grey_view, "a --> b -- c")
    assert read_card(corners).licence == "a --> b -- c"
    with pytest.raises(CardError, match="name of a licence"):
        checked_licence(" ")


@pytest.mark.parametrize(
    ("licence", "header"),
    [
        (None, {}),
        ("CC BY 4.0", {"license": "cc-by-4.0"}),
        ("a --> b -- c", {"license": "other", "license_name": "a --> b -- c"}),
    ],
)
def test_the_header_of_the_card_is_that_of_data_hubs(corners, licence, header):
    card = dataset_card(corners, read_distributions(corners, lambda: None), licence)
    assert yaml.safe_load(card.split("---\n")[1]) == {
        "pretty_name": "corners",
        **header,
        "task_categories": ["depth-estimation"],
        "tags": ["non-line-of-sight", "indirect-time-of-flight", "openexr"],
        "size_categories": ["n<1K"],
    }


# The required properties of the specification, https://docs.mlcommons.org/croissant/docs/croissant-spec.html
DATASET_NEEDS = {"@context", "@type", "conformsTo", "name", "description", "license", "url", "creator"}
FILE_NEEDS = {"@type", "@id", "name", "contentUrl", "encodingFormat", "sha256"}


def test_croissant_describes_the_files_that_are_there(corners):
    data = json.loads(croissant(corners, read_distributions(corners, lambda: None), "CC BY 4.0"))
    assert data.keys() >= DATASET_NEEDS | {"datePublished"}
    assert (data["@type"], data["conformsTo"]) == ("sc:Dataset", "http://mlcommons.org/croissant/1.0")
    files = [each for each in data["distribution"] if each["@type"] == "cr:FileObject"]
    sets = [each for each in data["distribution"] if each["@type"] == "cr:FileSet"]
    assert "dataset.json" in {file["@id"] for file in files}
    for file in files:
        assert file.keys() >= FILE_NEEDS
        content = (corners.root / file["contentUrl"]).read_bytes()
        assert file["sha256"] == hashlib.sha256(content).hexdigest()
    counts = {each["includes"]: len(list(corners.root.glob(each["includes"]))) for each in sets}
    rendered = {f"renders/*/{name}.exr": 3 for name in ("itof", "mirrored", "transient")}
    assert counts == {**rendered, "scenes/*/scene.json": 9}
    (scenes,) = data["recordSet"]
    index = json.loads((corners.root / "dataset.json").read_text())
    for field in scenes["field"]:
        assert field["source"]["fileObject"]["@id"] == "dataset.json"
        key = field["source"]["extract"]["jsonPath"].removeprefix("$.scenes[*].")
        assert all(isinstance(scene[key], str) for scene in index["scenes"])


def test_a_croissant_of_somebody_else_is_recognised(corners):
    assert has_no_other_croissant(corners)
    text = croissant(corners, read_distributions(corners, lambda: None), None)
    (corners.root / CROISSANT_FILE).write_text(text)
    assert has_no_other_croissant(corners)
    (corners.root / CROISSANT_FILE).write_text("{}")
    assert not has_no_other_croissant(corners)


@pytest.mark.parametrize("text", ["# My notes\n", ""])
def test_a_readme_of_somebody_else_is_recognised(corners, text):
    (corners.root / "README.md").write_text(text)
    assert not read_card(corners).is_ours


@pytest.mark.long
def test_a_readme_of_somebody_else_is_kept(corners):
    (corners.root / "README.md").write_text("")
    written = write_preview(corners, ["000000"], grey_view, "CC BY 4.0")
    assert (corners.root / "README.md").read_text() == ""
    assert [file.name for file in written] == ["contact_sheet.png", "distributions.png"]


@pytest.mark.long
def test_pictures_of_the_user_in_the_preview_are_kept(corners):
    write_preview(corners, ["000000"], grey_view)
    sheet, notes = corners.root / "preview" / "contact_sheet.png", corners.root / "preview" / "notes.txt"
    notes.write_text("mine")
    check_preview(corners, ["000000"], None)  # its own pictures may be replaced
    sheet.write_bytes(b"\x89PNG, mine")
    for refused in (check_preview, lambda *given: write_preview(*given[:2], grey_view, given[2])):
        with pytest.raises(
            CardError, match=r"contact_sheet\.png is not a picture that night-gen preview wrote"
        ):
            refused(corners, ["000000"], None)
    assert sheet.read_bytes() == b"\x89PNG, mine"
    assert notes.read_text() == "mine"


def test_the_card_of_captures_does_not_speak_of_blender_and_mitsuba(corners):
    measured = Dataset(corners.root, replace(corners.index, generator=MEASURED_GENERATOR))
    (corners.renders / "rendering.json").unlink(missing_ok=True)  # captures have none
    card = dataset_card(measured, read_distributions(corners, lambda: None), None)
    assert "captured with an indirect time-of-flight camera" in card
    of_renders = ("rendered", "rendering.json", "the transient", "light paths", "time axis", "upper bound")
    of_scenes = ("synthetic", "Blender", "Mitsuba", "depends on the seed", "to make the scenes again")
    for words in (*of_renders, *of_scenes):
        assert words not in card, words


def test_the_card_says_that_fields_of_view_differ(corners):
    spread = replace(corners.preset, camera_spread=CameraSpread(horizontal_fov_deg=5.0))
    many = Dataset(corners.root, replace(corners.index, preset=spread))
    card = dataset_card(many, read_distributions(corners, lambda: None), None)
    assert "horizontal field of view 55 to 65 degrees, that of each scene" in card


@pytest.mark.parametrize(
    "licence", ["[" * 100_000, "1" * 5000, '"a\\u0000b"'], ids=["deep", "long number", "control character"]
)
def test_a_licence_that_is_no_text_is_none(corners, licence):
    (corners.root / "README.md").write_text(
        f"<!-- night-gen preview writes this file; licence: {licence} -->"
    )
    assert read_card(corners) == EarlierCard(is_ours=True, licence=None)
