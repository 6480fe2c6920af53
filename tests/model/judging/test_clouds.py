"""Point clouds: distance of a prediction from the truth, its colours, and their figure."""

import json

import numpy as np
import pytest
import trimesh
from matplotlib.colors import to_rgba
from report_pages import WITH_WEBGL, Page, browse, needs_chromium
from scene_views import shown

from itof.pictures.pointclouds import (
    DISTANCE_COLOURS,
    FAR_M,
    TRUTH_COLOUR,
    distance_colours,
    distances_m,
    write_point_cloud,
)
from model.judging.evaluation import evaluate
from model.judging.report.report_scenes import clouds_figure
from model.judging.showcase import cloud_of
from scenegen.pose import camera_axes

pytestmark = pytest.mark.usefixtures("one_thread")


def scatters(axes):
    return [part for part in axes.collections if len(part.get_offsets())]


def test_distances_are_those_of_the_nearest_of_all_true_points():
    rng = np.random.default_rng(3)
    truth = rng.uniform(-1, 1, (83, 3)).astype(np.float32)
    points = rng.uniform(-2, 2, (57, 3)).astype(np.float32)
    every = np.linalg.norm(points[:, None].astype(float) - truth.astype(float), axis=-1)  # (57, 83)
    # Both are distances of float64 copies of the same float32 numbers.
    np.testing.assert_allclose(distances_m(points, truth), every.min(axis=1), rtol=1e-12)
    assert not distances_m(truth[::3], truth).any()


def test_a_shift_along_the_rays_of_a_fronto_parallel_plate_is_its_distance():
    x, y = np.meshgrid(np.arange(9) / 20, np.arange(7) / 20)
    plate = np.stack([x, y, np.full(x.shape, 3.0)], axis=-1).reshape(-1, 3).astype(np.float32)
    moved = plate + np.array([0, 0, 0.0625], np.float32)  # exact in float32
    assert (distances_m(moved, plate) == 0.0625).all()


def test_without_a_true_point_every_distance_is_infinite_and_red():
    points = np.ones((4, 3), np.float32)
    distance_m = distances_m(points, points[:0])
    assert np.isinf(distance_m).all()
    red = (255 * np.array(to_rgba(DISTANCE_COLOURS[-1]))).round()
    assert (distance_colours(distance_m) == red).all()
    assert distances_m(points[:0], points).shape == (0,)


def test_colours_go_from_green_at_zero_over_yellow_to_red_at_the_far_end():
    ends = distance_colours(np.array([0.0, FAR_M / 2, FAR_M, 5 * FAR_M]))
    wanted = [255 * np.array(to_rgba(name)) for name in (*DISTANCE_COLOURS, DISTANCE_COLOURS[-1])]
    # A colour map has 256 steps: half a step of at most 218 levels over 128 steps is below 1 level.
    assert np.abs(ends - np.array(wanted)).max() <= 1.5
    many = distance_colours(np.linspace(0, FAR_M, 50)).astype(int)
    redness = many[:, 0] - many[:, 1]
    assert (np.diff(redness) >= 0).all()


def test_a_point_cloud_file_holds_the_points_and_the_colour_of_each(tmp_path):
    points = np.random.default_rng(0).normal(size=(9, 3)).astype(np.float32)
    colours = distance_colours(np.linspace(0, FAR_M, 9))
    write_point_cloud(tmp_path / "a.ply", points, colours)
    read = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.vertices.astype(np.float32), points)
    np.testing.assert_array_equal(read.visual.vertex_colors, colours)
    write_point_cloud(tmp_path / "b.ply", points)
    assert b"red" not in (tmp_path / "b.ply").read_bytes()[:300]  # as before, without colours


def test_the_figure_shows_truth_blue_and_every_predicted_point_in_the_colour_of_its_distance():
    scenes = [shown(), shown("000007", truth=((1, 4), (1, 5), 3.1), prediction=((5, 9), (9, 18), 2.9))]
    figure = clouds_figure(scenes)
    boxes = [axes for axes in figure.axes if axes.name == "3d"]
    assert len(boxes) == 2
    for axes, scene in zip(boxes, scenes, strict=True):
        (dots,) = scatters(axes)
        right, forward, up = (np.asarray(values) for values in dots._offsets3d)
        drawn = np.stack([right, -up, forward], axis=-1)  # camera axes: y is down
        cloud = cloud_of(scene)
        points = np.concatenate([cloud.truth, cloud.prediction])
        inside = (np.abs(points - cloud.centre_m) <= cloud.reach_m).all(axis=1)
        np.testing.assert_array_equal(drawn, points[inside])
        distance_m = distances_m(scene.points_pred_m, scene.points_gt_m)
        blue = np.broadcast_to(to_rgba(TRUTH_COLOUR), (len(cloud.truth), 4))
        colours = np.concatenate([blue, distance_colours(distance_m) / 255])[inside]
        np.testing.assert_allclose(dots._facecolors, colours, atol=1e-12)
        assert f"mean distance {100 * distance_m.mean():.1f} cm" in axes.get_title()
    (bar,) = (axes for axes in figure.axes if axes.name != "3d")
    assert bar.get_xlim() == (0.0, 100 * FAR_M)
    assert bar.get_xlabel() == "prediction: distance from the nearest true point, cm"


def test_no_number_of_an_upright_axis_lies_on_its_line():
    figure = clouds_figure([shown()])
    figure.canvas.draw()
    (axes,) = (axes for axes in figure.axes if axes.name == "3d")
    line = axes.zaxis.line.get_window_extent()
    low, high = axes.get_zlim()
    ticks = axes.zaxis.majorTicks  # as drawn: `get_zticklabels` would put the numbers elsewhere
    numbers = [tick.label1.get_window_extent() for tick in ticks if low <= tick.get_loc() <= high]
    assert len(numbers) > 2
    assert min(number.x0 for number in numbers) >= line.x1


def test_scenes_without_points_have_a_place_in_the_figure_and_six_scenes_have_two_rows():
    nothing = ((0, 0), (0, 0), 0.0)
    scenes = [shown(truth=nothing), shown(prediction=nothing), shown(truth=nothing, prediction=nothing)]
    figure = clouds_figure([*scenes, *scenes])
    figure.canvas.draw()
    boxes = [axes for axes in figure.axes if axes.name == "3d"]
    said = [axes.get_title().splitlines()[1] for axes in boxes[:3]]
    assert said == ["no true point", "no predicted point", "no predicted point"]
    assert [len(scatters(axes)) for axes in boxes[:3]] == [1, 1, 0]
    assert len({round(axes.get_position().y0, 6) for axes in boxes}) == 2


@pytest.mark.long
def test_the_files_of_a_report_have_the_colours_of_the_distances(seeing_run, closed_form_scenes, tmp_path):
    evaluate(seeing_run, closed_form_scenes, tmp_path / "report", device="cpu", progress=False)
    clouds = tmp_path / "report" / "pointclouds"
    pairs = [(file, clouds / file.name.replace("pred", "gt")) for file in sorted(clouds.glob("*_pred.ply"))]
    assert pairs  # this network shows objects
    for predicted, true in pairs:
        prediction, truth = trimesh.load(predicted), trimesh.load(true)
        distance_m = distances_m(prediction.vertices, truth.vertices)
        np.testing.assert_array_equal(prediction.visual.vertex_colors, distance_colours(distance_m))
        blue = (255 * np.array(to_rgba(TRUTH_COLOUR))).round()
        assert (truth.visual.vertex_colors == blue).all()


def test_scenes_without_a_point_cloud_are_counted_in_one_sentence(
    finished_run, closed_form_scenes, tmp_path, caplog
):
    caplog.set_level("INFO")
    report = evaluate(finished_run, closed_form_scenes, tmp_path / "out", mask_threshold=1e6, progress=False)
    said = [record.getMessage() for record in caplog.records if "point cloud" in record.getMessage()]
    assert len(report.scenes) > 1
    assert said == [f"no object, so no point cloud: in {len(report.scenes)} predictions and 0 true images"]


def test_the_clouds_of_the_page_have_the_walls_of_their_scene(judged_run, closed_form_scenes):
    _, folder = judged_run
    page = Page((folder / "index.html").read_text())
    camera = closed_form_scenes.scene("000000").camera
    for cloud in page.data["cloud-data"]:
        relay, middle = np.array(cloud["walls"]) @ camera_axes(camera) + camera.location_m
        # The paper's relay wall has x = 0, its middle wall y = 0; the page has millimetres.
        assert np.abs(relay[:, 0]).max() < 2e-3
        assert np.abs(middle[:, 1]).max() < 2e-3
        assert 1 / np.linalg.norm(cloud["plane"]) == pytest.approx(camera.location_m[0], rel=1e-9)


CLICK = """<script>setTimeout(() => {
  const box = document.querySelector("[data-cloud]");
  box.querySelectorAll(".updatemenu-button")[1].dispatchEvent(new Event("click"));
  setTimeout(() => {
    const visible = box._fullData.filter((trace) => trace.visible);
    const shown = visible.map(({ name, x, y, z }) => ({ name, x, y, z }));
    document.body.dataset.room = JSON.stringify({ shown, range: box._fullLayout.scene.zaxis.range });
  }, 2000);
}, 5000);</script></body>"""


@pytest.mark.long
@needs_chromium
def test_in_the_view_of_the_room_a_click_shows_walls_and_the_object_at_its_own_place(judged_run, tmp_path):
    text = (judged_run[1] / "index.html").read_text()
    (tmp_path / "page.html").write_text(CLICK.join(text.rsplit("</body>", 1)))
    page = Page(browse(tmp_path / "page.html", tmp_path, WITH_WEBGL)[0])
    room = json.loads(dict(page.attributes)["data-room"])
    names = ["truth", "prediction", "camera", "relay wall", "middle wall"]
    assert [trace["name"] for trace in room["shown"]] == names
    cloud = page.data["cloud-data"][0]
    own = np.array([room["shown"][0][axis] for axis in "xyz"]).T
    image, plane = np.array(cloud["truth"]), np.array(cloud["plane"])
    np.testing.assert_allclose((own + image) @ plane / 2, 1, rtol=1e-9)  # half way is the wall
    np.testing.assert_allclose(np.cross(own - image, plane), 0, atol=1e-9)
    near_m, far_m = room["range"]
    assert near_m < 0 < own[:, 2].min()
    assert own[:, 2].max() < far_m
