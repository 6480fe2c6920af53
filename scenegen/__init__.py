"""Scenes, presets and dataset folders as plain data, and the code that makes them.

Imports no other package of NIGHT but the basement (`disk`, `processes`). `scenegen.making` makes scenes in
Blender, in processes of its own. The names below are loaded at their first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
