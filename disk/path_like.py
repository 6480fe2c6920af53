"""The type of a path that a caller gives: text, or an object such as `pathlib.Path`."""

from __future__ import annotations

import os
from typing import TypeAlias

PathLike: TypeAlias = str | os.PathLike[str]
