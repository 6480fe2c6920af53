from .contract import ContractError
from .file_hashes import FileHashes, sha256_of
from .inner_paths import OutsideError, inside
from .night_error import NightError
from .partials import is_partial, remove_leftovers
from .path_like import PathLike
from .preset_files import PresetError, data_folder, read_settings, shipped_file
from .whole_writing import whole_file, whole_files, whole_folder, write_text

__all__ = [
    "ContractError",
    "FileHashes",
    "NightError",
    "OutsideError",
    "PathLike",
    "PresetError",
    "data_folder",
    "inside",
    "is_partial",
    "read_settings",
    "remove_leftovers",
    "sha256_of",
    "shipped_file",
    "whole_file",
    "whole_files",
    "whole_folder",
    "write_text",
]
