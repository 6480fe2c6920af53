"""Scenes of a report that are made by hand: truth and prediction are blocks of pixels at one depth."""

import numpy as np

from itof import DepthMap
from itof.metrics import image_metrics, no_object_metrics
from itof.pictures.pointclouds import object_points
from model.judging.scene_result import SceneResult, disc_iou
from model.judging.showcase import ShownScene

HEIGHT, WIDTH = 12, 20
FOV_DEG = 60.0
# Corners of a relay wall in the plane z = 2 of the camera's axes, and of a middle wall in the plane x = 0.5.
WALLS_M = np.array(
    [
        [[-1, -1, 2], [3, -1, 2], [3, 1, 2], [-1, 1, 2]],
        [[0.5, -1, 0], [0.5, -1, 1.5], [0.5, 1, 1.5], [0.5, 1, 0]],
    ]
)


def block(rows, columns, radial_depth_m):
    """A depth map whose object is a block of pixels at one radial depth."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[slice(*rows), slice(*columns)] = True
    return DepthMap.of_object(np.where(mask, radial_depth_m, 0.0), mask, 20e6)


def shown(
    scene="000001", object_class="cone", truth=((2, 8), (3, 11), 2.5), prediction=((3, 9), (3, 13), 2.8)
):
    truth, prediction = block(*truth), block(*prediction)
    views = (prediction.radial_depth_m, prediction.mask, truth.radial_depth_m, truth.mask)
    depth_m = float(truth.radial_depth_m[truth.mask].mean()) if truth.mask.any() else None
    result = SceneResult(
        *(scene, object_class, False, 0.5, (1.0, 1.0, 1.0), int(truth.mask.sum()), depth_m),
        prediction=image_metrics(*views),
        no_object=no_object_metrics(truth.radial_depth_m, truth.mask),
        roundness_gt=disc_iou(truth.mask),
        roundness_pred=disc_iou(prediction.mask),
    )
    points = [object_points(view.radial_depth_m, view.mask, FOV_DEG) for view in (truth, prediction)]
    return ShownScene("rank 2 of 9", result, truth, prediction, *points, WALLS_M)
