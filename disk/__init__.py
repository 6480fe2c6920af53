"""Files that are complete or absent, their contents checked, and where the program keeps its own.

`whole_writing` writes files and folders that appear whole or not at all, in the temporary folders of
`partials`. `own_files` refuses to replace a folder with files of others. `inner_paths` refuses paths that
lead out of a folder, and `plain_file` reads no pipe and no device. `locks` are for processes, `checksums`
stand in the files themselves. `contract` checks JSON and TOML, with the bounds of `quantities`.
`machine_memory` says what fits into memory. Knows nothing of light or scenes, and imports no other package of
NIGHT.

The names below are loaded at their first use: a process that reads a measurement needs few of them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
