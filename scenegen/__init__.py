"""What a scene and a dataset folder are, as plain data, and the one file that makes them in Blender.

`scenegen.making.blender` is not imported here: it needs `bpy`, and only ``night-gen`` does.
"""

from scenegen.chatter import silenced
from scenegen.dataset import (
    Dataset,
    DatasetError,
    DatasetIndex,
    RenderingProvenance,
    SceneEntry,
    build_index,
    open_dataset,
    write_index,
)
from scenegen.files.file_hashes import FileHashes, sha256_of
from scenegen.files.whole_files import is_partial, whole_file, whole_folder, write_text
from scenegen.night_error import NightError
from scenegen.pose import camera_axes, rotation_matrix, wall_normal
from scenegen.preset import Preset, PresetError, data_folder, load_preset, preset_from_dict, read_settings
from scenegen.render_folder import (
    RECORD_FILE,
    FailureRecord,
    FileRecord,
    RenderRecord,
    read_failure,
    read_record,
    remove_failure,
    write_failure,
    write_record,
)
from scenegen.sampling import SamplingError, leaks, sample_scene, sample_valid_scene
from scenegen.scene import Camera, Scene, Split, scene_from_json, scene_id, scene_to_json

__all__ = [
    "RECORD_FILE",
    "Camera",
    "Dataset",
    "DatasetError",
    "DatasetIndex",
    "FailureRecord",
    "FileHashes",
    "FileRecord",
    "NightError",
    "Preset",
    "PresetError",
    "RenderRecord",
    "RenderingProvenance",
    "SamplingError",
    "Scene",
    "SceneEntry",
    "Split",
    "build_index",
    "camera_axes",
    "data_folder",
    "is_partial",
    "leaks",
    "load_preset",
    "open_dataset",
    "preset_from_dict",
    "read_failure",
    "read_record",
    "read_settings",
    "remove_failure",
    "rotation_matrix",
    "sample_scene",
    "sample_valid_scene",
    "scene_from_json",
    "scene_id",
    "scene_to_json",
    "sha256_of",
    "silenced",
    "wall_normal",
    "whole_file",
    "whole_folder",
    "write_failure",
    "write_index",
    "write_record",
    "write_text",
]
