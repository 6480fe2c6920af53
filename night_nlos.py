"""NIGHT: its version, the four programs that pip installs, and in Python the names that most people need.

``import night_nlos as night`` leads through the chain: presets and scenes (`load_preset`, `make_dataset`),
renders (`render_dataset`), training (`train`), use (`load`, `predict_file`, `refine`) and judgement
(`evaluate`). The other names are in `scenegen`, `itof`, `render` and `model`.

The other top-level modules (`cli`, `model`, `render`, ...) have common names. A module or folder of the same
name that comes first on Python's module search path, for example through PYTHONPATH, would be imported in
their place. Each program therefore first looks where all of them would come from, without running them.
"""

import signal
import sys
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_OFFERED = {
    "scenegen": ("load_preset", "preset_from_dict", "make_dataset", "open_dataset"),
    "itof": ("DepthMap", "TransientReader", "check_capture", "import_capture", "read_image"),
    "render": ("Renderer", "render_dataset", "settings_for"),
    "model": (
        *("networks", "settings_from_dict", "train", "training_preset"),
        *("evaluate", "export_onnx", "load", "predict_file", "refine", "refine_split"),
    ),
}
_HOME = {name: module for module, names in _OFFERED.items() for name in names}
__all__ = ["__version__", "night_eval", "night_gen", "night_render", "night_train", *_HOME]

__version__ = version("night-nlos")
_MODULES = ("cli", "commandline", "disk", "processes", "scenegen", "itof", "render", "model")
_WRONG_INSTALLATION = 2  # exit code, as for everything that the user can change


def __getattr__(name: str) -> Any:
    """A name of `scenegen`, `itof`, `render` or `model`, which are imported at its first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    sentence = foreign_module()
    if sentence is not None:
        raise ImportError(sentence)
    globals()[name] = found = getattr(import_module(_HOME[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted(__all__)


def foreign_module() -> str | None:
    """A sentence about the first of our modules that would not come from this file's folder; else None."""
    home = Path(__file__).resolve().parent
    for name in _MODULES:
        spec = find_spec(name)
        places = [] if spec is None else [spec.origin] if spec.origin else spec.submodule_search_locations
        if not places:
            return f"the module {name} of NIGHT is missing: install NIGHT again"
        place = Path(str(next(iter(places)))).resolve()
        if place not in (home / f"{name}.py", home / name / "__init__.py"):
            return (
                f"{place} would be imported in place of NIGHT's own module {name} in {home}: rename it, or "
                "take its folder off Python's module search path (PYTHONPATH)"
            )
    return None


def _run(program: str) -> None:
    """Run a click command of `cli`."""
    interrupt = signal.getsignal(signal.SIGINT)
    if interrupt is signal.default_int_handler:  # not ignored, as in the background of a script
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until there is a command that can say something
    sentence = foreign_module()
    if sentence is not None:
        if sys.stderr is not None:  # it was not closed, as by 2>&-
            sys.stderr.write(f"Error: {sentence}\n")
        sys.exit(_WRONG_INSTALLATION)
    from commandline.streams_and_caches import prepare_process

    prepare_process()
    import cli

    if interrupt is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    getattr(cli, program)()


def night_gen() -> None:
    """Run the program ``night-gen``."""
    _run("night_gen")


def night_render() -> None:
    """Run the program ``night-render``."""
    _run("night_render")


def night_train() -> None:
    """Run the program ``night-train``."""
    _run("night_train")


def night_eval() -> None:
    """Run the program ``night-eval``."""
    _run("night_eval")
