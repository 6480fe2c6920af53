"""Files that are complete or absent, their contents checked, and where the program keeps its own.

`whole_writing` writes files and folders that appear whole or not at all, in the temporary folders of
`partials`. `own_files` refuses to replace a folder with files of others. `inner_paths` refuses paths that
lead out of a folder, and `plain_file` reads no pipe and no device. `locks` are for processes. `contract`
checks JSON and TOML, with the bounds of `quantities`. `machine_memory` says what fits into memory. Knows
nothing of light or scenes, and imports no other package of NIGHT.
"""

from disk.contract import ContractError
from disk.file_hashes import FileHashes, sha256_of
from disk.inner_paths import OutsideError, inside
from disk.night_error import NightError
from disk.partials import is_partial, remove_leftovers
from disk.path_like import PathLike
from disk.preset_files import PresetError, data_folder, read_settings, shipped_file
from disk.whole_writing import whole_file, whole_files, whole_folder, write_text

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
