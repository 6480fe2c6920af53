"""Scenes whose files are not those of ``dataset.json``: refused, rendered on request as data, repaired."""

import json
import re
import shutil

import numpy as np
import pytest
import trimesh
from night_commands import night_here, refusal
from render_runs import SETTINGS, results

from disk import NightError
from itof import read_image
from render.rendering import Renderer
from render.settings import RenderSettings
from scenegen import open_dataset, read_record
from scenegen.scene_folder import folder_digest

ONLY = ("--only", "000002")
HOSTILE = """<scene version="3.0.0">
<path value="{folder}"/><include filename="{folder}/more.xml"/><bsdf type="evil"/>
</scene>"""


def scene(data, name):
    return data / "scenes" / "000002" / name


def flip_mesh(data):
    file = scene(data, "hidden_object_0.ply")
    content = bytearray(file.read_bytes())
    content[-5] ^= 1
    file.write_bytes(content)


def brighten(data):
    file = scene(data, "scene.json")
    text = file.read_text()
    assert '"irradiance": 1.0' in text
    file.write_text(text.replace('"irradiance": 1.0', '"irradiance": 2.0'))


def write_hostile_xml(data):
    for name in ("scene.xml", "mirrored.xml"):
        scene(data, name).write_text(HOSTILE.format(folder=data))


def measured(data):
    return read_image(data / "renders" / "000002" / "itof.exr")


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (flip_mesh, "scene.json or a mesh in"),
        (brighten, "scene.xml or scene.json was changed"),
        (write_hostile_xml, "scene.xml or scene.json was changed"),
        (lambda data: scene(data, "notes.txt").write_text("mine"), "notes.txt is not one of its files"),
        (lambda data: scene(data, "relay_wall.ply").unlink(), "relay_wall.ply is missing"),
        (lambda data: shutil.rmtree(scene(data, "")), "000002 is missing or empty"),
    ],
)
def test_an_edited_scene_is_refused_before_any_scene_is_rendered(unrendered, edit, words):
    edit(unrendered)
    for more in ((), ("--dry-run",)):
        sentence = refusal("night-render", unrendered, *SETTINGS, *more)
        assert "scene 000002 is not as night-gen made it" in sentence
        assert words in sentence
        assert f"night-gen scenes {unrendered} repairs it" in sentence
        assert "--accept edited" in sentence
    assert list((unrendered / "renders").glob("[0-9]*")) == []
    done = night_here("night-render", unrendered, *SETTINGS, "--dry-run", "--only", "000001")
    assert done.returncode == 0, done.stderr  # the others can be rendered
    status = night_here("night-render", "status", unrendered)
    assert "1 of the scenes that are not done have other files than dataset.json lists" in status.stdout
    with pytest.raises(NightError, match="000002"):
        Renderer(open_dataset(unrendered), RenderSettings(device="cpu")).render("000002")


@pytest.mark.long
@pytest.mark.parametrize("vouched", [False, True])
def test_a_hostile_scene_file_is_never_opened(unrendered, seven_renders, render_here, vouched):
    write_hostile_xml(unrendered)
    dataset = open_dataset(unrendered)
    if vouched:  # by a dataset.json of the same author
        index = json.loads((unrendered / "dataset.json").read_text())
        entries = [
            entry | {"sha256": folder_digest(dataset.scene_folder(entry["id"]))} for entry in index["scenes"]
        ]
        (unrendered / "dataset.json").write_text(json.dumps(index | {"scenes": entries}))
        done = render_here(unrendered, *SETTINGS, *ONLY)
    else:
        done = render_here(unrendered, *SETTINGS, *ONLY, "--accept", "edited")
        assert re.search(
            r"scene.xml and 1 more such files differ from scene.json, which has no effect", done.stderr
        )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 scene rendered")
    for name, values in measured(seven_renders).channels.items():
        np.testing.assert_array_equal(measured(unrendered).channels[name], values)


def test_a_scene_whose_camera_has_another_shape_is_refused(unrendered):
    (scene_id, *_) = open_dataset(unrendered).ids()
    file = unrendered / "scenes" / scene_id / "scene.json"
    file.write_text(file.read_text().replace('"height": 18', '"height": 24', 1))
    renderer = Renderer(open_dataset(unrendered), RenderSettings(device="cpu", accept_edited=True))
    with pytest.raises(NightError, match="its camera has 24x24 pixels, another shape than the 24x18"):
        renderer.render(scene_id)


def test_an_edited_scene_is_rendered_as_it_is_when_that_is_accepted(unrendered, seven_renders, render_here):
    brighten(unrendered)
    done = render_here(unrendered, *SETTINGS, *ONLY, "--accept", "edited")
    assert done.returncode == 0, done.stderr
    once, twice = (measured(data).phasors()[0] for data in (seven_renders, unrendered))
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-5)
    record = read_record(unrendered / "renders" / "000002")
    assert record.attributes["scene_files"] == "edited"
    assert measured(unrendered).attributes["scene_files"] == "edited"
    assert "scene_files" not in measured(seven_renders).attributes
    before = json.loads(read_record(seven_renders / "renders" / "000002").recipe)
    assert json.loads(record.recipe) | {"scene_sha256": before["scene_sha256"]} == before
    assert "1 done" in night_here("night-render", "status", unrendered).stdout
    assert render_here(unrendered, *ONLY).stdout.startswith("0 scenes rendered, 1 were there")
    assert night_here("night-render", "verify", unrendered).stdout.startswith(
        "1 scene checked: 1 good, 0 bad"
    )
    brighten_back = scene(unrendered, "scene.json")
    brighten_back.write_text(brighten_back.read_text().replace('"irradiance": 2.0', '"irradiance": 1.0'))
    assert "rendered with other settings" in refusal("night-render", unrendered, *ONLY)


def test_verification_blames_a_damaged_scene_and_night_gen_repairs_it(
    rendered_copy, seven_renders, render_here
):
    flip_mesh(rendered_copy)
    done = night_here("night-render", "verify", rendered_copy)
    assert done.returncode == 1
    assert re.search(
        r"^scene files damaged: 000002: scene.json or a mesh in .* changed$", done.stdout, re.MULTILINE
    )
    assert "7 scenes checked: 6 good, 0 bad; 0 not rendered; 1 not checked" in done.stdout
    assert f"night-gen scenes {rendered_copy} repairs scene files" in done.stderr
    assert read_record(rendered_copy / "renders" / "000002") is not None
    made = night_here("night-gen", "scenes", rendered_copy)
    assert made.returncode == 0, made.stderr
    done = night_here("night-render", "verify", rendered_copy)
    assert done.returncode == 0, done.stdout
    assert render_here(rendered_copy).stdout.startswith("0 scenes rendered, 7 were there")
    assert results(rendered_copy) == results(seven_renders)


def test_a_bad_render_of_an_intact_scene_is_still_blamed(rendered_copy):
    file = rendered_copy / "renders" / "000002" / "itof.exr"
    file.write_bytes(file.read_bytes()[:-1])
    done = night_here("night-render", "verify", rendered_copy, *ONLY)
    assert "bad: 000002: itof.exr" in done.stdout
    assert "scene files" not in done.stdout


def moved_in_the_label(scene, meshes):
    scene["hidden_objects"][0]["location_m"][0] += 0.4


def turned_in_the_label(scene, meshes):
    scene["hidden_objects"][0]["rotation_deg"][1] += 30.0


def wall_moved_in_the_label(scene, meshes):
    scene["middle_wall"]["location_m"][2] += 0.1


def mirror_image_left_behind(scene, meshes):
    scene["hidden_objects"][0]["location_m"][0] += 0.1
    meshes["hidden_object_0.ply"].vertices += [0.1, 0, 0]


def another_shape_in_the_label(scene, meshes):
    """The root of a box's area is 1.38 times that of an ellipsoid in it: 0.38 of 0.6 m."""
    scene["hidden_objects"][0]["shape"] = "sphere"


def object_moved(scene, meshes):
    mirror_image_left_behind(scene, meshes)
    meshes["mirrored_hidden_object_0.ply"].vertices -= [0.1, 0, 0]  # the relay wall is in the plane x = 0


@pytest.mark.parametrize(
    ("edit", "wrong"),
    [
        (moved_in_the_label, "hidden_object_0.ply is up to 0.4 m from what scene.json has"),
        (turned_in_the_label, r"hidden_object_0.ply is up to 0.\d+ m from what scene.json has"),
        (wall_moved_in_the_label, "middle_wall.ply is up to 0.1 m from what scene.json has"),
        (another_shape_in_the_label, "hidden_object_0.ply is up to 0.23 m from what scene.json has"),
        (mirror_image_left_behind, "mirrored_hidden_object_0.ply is up to 0.1 m from what"),
        (object_moved, None),
    ],
)
def test_meshes_that_are_not_where_the_scene_says_are_refused(unrendered, edit, wrong):
    scene_id = next(
        each.id for each in open_dataset(unrendered).index.scenes if each.object_class == "parallelepiped"
    )
    folder = unrendered / "scenes" / scene_id
    data = json.loads((folder / "scene.json").read_text())
    meshes = {file.name: trimesh.load(file, process=False) for file in folder.glob("*.ply")}
    edit(data, meshes)
    (folder / "scene.json").write_text(json.dumps(data))
    for name, mesh in meshes.items():
        (folder / name).write_bytes(mesh.export(file_type="ply"))
    renderer = Renderer(open_dataset(unrendered), RenderSettings(device="cpu", accept_edited=True))
    if wrong is None:
        assert renderer.render(scene_id).attributes["scene_files"] == "edited"
    else:
        with pytest.raises(NightError, match=wrong):
            renderer.render(scene_id)
