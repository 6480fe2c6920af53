"""The corner of a dataset: its camera and relay wall, and whether all scenes share them."""

from __future__ import annotations

from disk import NightError
from itof.wall.wall_view import WallView
from model.network.channels import InputSpec
from scenegen import Dataset
from scenegen.pose import wall_geometry


class ProjectorError(NightError):
    """The light of a dataset is not that of a flash at the camera."""


def wall_view(dataset: Dataset) -> WallView:
    """Camera and relay wall of a dataset, read from its first scene; they are the same in every scene.

    Where each scene has its camera elsewhere, the camera is that of the preset, in the middle of them.

    Raises
    ------
    ProjectorError : the projector is no flash at the camera.
    """
    scene, preset = dataset.scene(dataset.ids()[0]), dataset.preset
    if not scene.has_flash:
        raise ProjectorError(
            f"{dataset.root} has a projector of its own: networks know only a flash at the camera, with its "
            "field of view"
        )
    camera = scene.camera if preset.is_one_corner else preset.camera
    return WallView(**wall_geometry(camera, scene.relay_wall))


def many_corners_problem(dataset: Dataset, inputs: InputSpec) -> str | None:
    """Why a network with these inputs has no wall to compare the scenes of a dataset with; None if it has.

    Where each scene has its camera elsewhere, only a fit finds the wall of a scene.
    """
    if dataset.preset.is_one_corner or not inputs.uses_residual or inputs.self_calibrates:
        return None
    return (
        f"each scene of {dataset.root} has its camera elsewhere (camera_spread), and the reference "
        f"{inputs.reference} needs one place for all: train with --reference self"
    )
