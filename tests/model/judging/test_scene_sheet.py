"""What a report shows of every scene, and what a notebook shows of it."""

from base64 import b64decode
from io import BytesIO

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image
from report_pages import Page

from itof import DepthMap
from itof.pictures.depth_film import depth_levels
from itof.pictures.figures import depth_range
from model.data.shards import open_shards
from model.judging.scene_sheet import SceneSheet
from model.prediction.predictor import load

pytestmark = pytest.mark.usefixtures("one_thread")


def test_the_page_holds_truth_and_prediction_of_every_scene_by_accuracy(
    judged_run, finished_run, closed_form_scenes
):
    report, folder = judged_run
    sheet = Page((folder / "index.html").read_text()).data["scene-data"]
    content = b64decode(sheet["src"].removeprefix("data:image/png;base64,"))
    picture = np.asarray(Image.open(BytesIO(content)))  # places in the palette
    shards = open_shards(closed_form_scenes, progress=False)
    place = len(report.scenes) - 2
    result = report.ranked[place]
    assert sheet["texts"][place].startswith(f"{place + 1} of {len(report.scenes)}: {result.scene}, ")
    row = [scene.id for scene in shards.manifest.scenes].index(result.scene)
    block = shards.read([row])
    predicted = load(finished_run, "cpu").predict(block.phasors[0])
    truth = DepthMap.of_object(block.radial_depth_m[0], block.mask[0] > 0, 20e6)
    down, right = divmod(place, sheet["columns"])
    height, width = sheet["height"], sheet["width"]
    tile = picture[down * height :, right * width :][:height, :width]
    for side, one in ((tile[:, : width // 2], truth), (tile[:, width // 2 + 1 :], predicted)):
        np.testing.assert_array_equal(side, depth_levels(one, depth_range(truth, predicted)))


def test_the_picture_of_very_many_large_scenes_leaves_out_rows_and_columns():
    sheet, mask = SceneSheet(count=500), np.ones((240, 320), bool)
    sheet.add("000000", *[DepthMap.of_object(2.0 * mask, mask, 20e6)] * 2)
    assert 500 * sheet.tiles["000000"].size < 1.1 * 4e6


def test_a_report_in_a_notebook_has_every_scene_beside_no_object(judged_run):
    report, _ = judged_run
    figure = report.plot()
    plt.close(figure)
    assert [axes.get_xlabel() for axes in figure.axes][:2] == ["MAE over all pixels, cm", "mIoU"]
    counts = sum(patch.get_height() for patch in figure.axes[0].patches)
    assert counts == 2 * len(report.scenes)  # prediction and "no object"
