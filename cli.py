"""The four commands: ``night-gen``, ``night-render``, ``night-train``, ``night-eval``.

Each is a file of `commandline`. Importing them loads neither torch nor Mitsuba nor Blender: a command imports
what it needs when it runs.
"""

from commandline.evaluation import night_eval
from commandline.rendering import night_render
from commandline.scenes import night_gen
from commandline.training import night_train

__all__ = ["night_eval", "night_gen", "night_render", "night_train"]
