"""Scenes, presets and dataset folders as plain data, and the code that makes them.

Imports neither `itof` nor `render` nor `model`. `scenegen.files` has files that are complete or absent.
`scenegen.making` makes scenes in Blender; only ``night-gen`` needs it, and it is not imported here.
"""

from scenegen.chatter import silenced
from scenegen.contract import ContractError
from scenegen.dataset import (
    Dataset,
    DatasetError,
    DatasetIndex,
    SceneEntry,
    build_index,
    open_dataset,
    scene_entry,
    write_index,
)
from scenegen.files.file_hashes import FileHashes, sha256_of
from scenegen.files.inside import OutsideError, inside
from scenegen.files.partials import is_partial, remove_leftovers
from scenegen.files.path_like import PathLike
from scenegen.files.whole_files import whole_file, whole_files, whole_folder, write_text
from scenegen.night_error import NightError
from scenegen.pose import camera_axes, rotation_matrix, wall_normal
from scenegen.preset import Preset, load_preset, preset_from_dict
from scenegen.preset_files import PresetError, data_folder, read_settings, shipped_file
from scenegen.recorded_files import RENDER_AGAIN, RenderFileError, is_recorded, recorded_file
from scenegen.render_folder import (
    GROUND_TRUTH_FILE,
    IMAGE_FILES,
    MEASUREMENT_FILE,
    MIRRORED_TRANSIENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILE,
    TRANSIENT_FILES,
    BadRender,
    FailureRecord,
    FileRecord,
    RenderRecord,
    forget_bad_render,
    read_bad_render,
    read_failure,
    read_recipe,
    read_record,
    remove_failure,
    write_bad_render,
    write_failure,
    write_record,
)
from scenegen.rendering_record import (
    RENDERING_FILE,
    RenderingRecord,
    read_rendering_record,
    write_rendering_record,
)
from scenegen.sampling import SamplingError, leaks, sample_scene, sample_valid_scene
from scenegen.scene import Camera, Scene, Split, scene_from_json, scene_id, scene_to_json

__all__ = [
    "GROUND_TRUTH_FILE",
    "IMAGE_FILES",
    "MEASUREMENT_FILE",
    "MIRRORED_TRANSIENT_FILE",
    "RECORD_FILE",
    "RENDERING_FILE",
    "RENDER_AGAIN",
    "TRANSIENT_FILE",
    "TRANSIENT_FILES",
    "BadRender",
    "Camera",
    "ContractError",
    "Dataset",
    "DatasetError",
    "DatasetIndex",
    "FailureRecord",
    "FileHashes",
    "FileRecord",
    "NightError",
    "OutsideError",
    "PathLike",
    "Preset",
    "PresetError",
    "RenderFileError",
    "RenderRecord",
    "RenderingRecord",
    "SamplingError",
    "Scene",
    "SceneEntry",
    "Split",
    "build_index",
    "camera_axes",
    "data_folder",
    "forget_bad_render",
    "inside",
    "is_partial",
    "is_recorded",
    "leaks",
    "load_preset",
    "open_dataset",
    "preset_from_dict",
    "read_bad_render",
    "read_failure",
    "read_recipe",
    "read_record",
    "read_rendering_record",
    "read_settings",
    "recorded_file",
    "remove_failure",
    "remove_leftovers",
    "rotation_matrix",
    "sample_scene",
    "sample_valid_scene",
    "scene_entry",
    "scene_from_json",
    "scene_id",
    "scene_to_json",
    "sha256_of",
    "shipped_file",
    "silenced",
    "wall_normal",
    "whole_file",
    "whole_files",
    "whole_folder",
    "write_bad_render",
    "write_failure",
    "write_index",
    "write_record",
    "write_rendering_record",
    "write_text",
]
