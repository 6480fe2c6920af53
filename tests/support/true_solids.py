"""The hidden objects of a scene as solids in camera axes, as refinement describes them."""

import numpy as np

from model.data.corner import wall_view
from model.refinement.light.room import in_camera_axes
from model.refinement.light.solids import Solid
from scenegen import rotation_matrix


def solids_of(dataset, scene_id):
    view, axes = wall_view(dataset), np.asarray(wall_view(dataset).camera_axes)
    return tuple(
        Solid(
            part.shape,
            part.size_m,
            in_camera_axes(part.location_m, view),
            axes @ rotation_matrix(part.rotation_deg),
        )
        for part in dataset.scene(scene_id).hidden_objects
    )
