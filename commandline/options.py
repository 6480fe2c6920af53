"""Options that several commands have, and those that are made of settings."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import click

from itof.sensor.cameras import load_sensor
from scenegen import Dataset
from scenegen.preset import MOST_BOUNCES

_Command = TypeVar("_Command", bound=Callable[..., None])


class Place(click.Path):
    """A file or folder whose name is UTF-8: Mitsuba, safetensors and PyTorch take no other."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; whether there is anything is for the command to say."""
        if not os.fspath(value):  # a variable of the shell that is not set
            self.fail("the name is empty; write . for the current folder", param, ctx)
        try:
            os.fspath(value).encode()
        except UnicodeEncodeError:
            self.fail(f"the name {value!r} is not UTF-8", param, ctx)
        return Path(value)


class Number(click.FloatRange):
    """A number in a range; NaN, which is neither below nor above anything, is in none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return number


FOLDER = Place()


class Megahertz(click.ParamType):
    """``20,62.5``: modulation frequencies in MHz, as Hz in ascending order, each once."""

    name = "MHZ,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Exact to the last digit: 0.1 MHz are 100000 Hz."""
        try:
            frequencies_hz = sorted({float(Decimal(number).scaleb(6)) for number in value.split(",")})
        except (ArithmeticError, ValueError):
            self.fail(f"{value!r} is no list of frequencies; write it like 20,62.5", param, ctx)
        if not all(0 < frequency_hz < math.inf for frequency_hz in frequencies_hz):
            self.fail(f"{value!r}: a frequency is a number of MHz above 0", param, ctx)
        return tuple(frequencies_hz)


class Duration(click.ParamType):
    """``90s``, ``30min`` or ``2h``: a time, as seconds."""

    name = "TIME"
    _SECONDS: ClassVar = {"s": 1, "min": 60, "h": 3600}

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Seconds; 0 is no time."""
        match = re.fullmatch(r"([0-9]{1,6}(?:\.[0-9]{1,6})?)(s|min|h)", value)
        if match is None or not float(match[1]):
            self.fail(f"{value!r} is no time; write it like 90s, 30min or 2h", param, ctx)
        return float(match[1]) * self._SECONDS[match[2]]


class Size(click.ParamType):
    """``160x120``: width and height in pixels."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Width and height; what fits the camera is for the dataset to say."""
        match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", value)
        if match is None:
            self.fail(f"{value!r} is no image size; write it like 160x120", param, ctx)
        return int(match[1]), int(match[2])


class Pixel(click.ParamType):
    """``12,7``: column and row of a pixel, from 0 at the upper left."""

    name = "X,Y"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Column and row; whether the image has this pixel is for the render to say."""
        match = re.fullmatch(r"([0-9]{1,9}),([0-9]{1,9})", value)
        if match is None:
            self.fail(f"{value!r} is no pixel; write it like 12,7", param, ctx)
        return int(match[1]), int(match[2])


class Counts(click.ParamType):
    """``1,10,100``: whole numbers from 1 on."""

    name = "N,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The numbers in ascending order, each once."""
        if not re.fullmatch(r"[0-9]{1,6}(,[0-9]{1,6})*", value) or 0 in map(int, value.split(",")):
            self.fail(f"{value!r} is no list of whole numbers from 1 on; write it like 1,10,100", param, ctx)
        return tuple(sorted({int(number) for number in value.split(",")}))


class Sensor(click.ParamType):
    """``mlx75027`` or ``mine.toml``: a camera of data/sensors, or a file that describes one."""

    name = "CAMERA"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Its settings."""
        return load_sensor(value)


class Sectioned(click.Option):
    """An option that the help shows under a heading of its own."""

    def __init__(self, *args: Any, section: str, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.section = section


def option(section: str, *names: str, **attributes: Any) -> Callable[[_Command], _Command]:
    """`click.option` under a heading."""
    return click.option(*names, cls=Sectioned, section=section, **attributes)


def options(*options: Callable[[_Command], _Command]) -> Callable[[_Command], _Command]:
    """Several options as one decorator, in their order."""
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(options), command)


def chosen_scenes(dataset: Dataset, only: tuple[str, ...]) -> list[str]:
    """The scenes that are named, each once, or all."""
    return [dataset.entry(scene_id).id for scene_id in dict.fromkeys(only)] or dataset.ids()


DEVICE_HELP = "Where to compute; auto takes a GPU if there is one."
DEVICES = click.Choice(["auto", "cpu", "cuda"])
DEVICE = click.option("--device", type=DEVICES, default="auto", show_default=True, help=DEVICE_HELP)
ONLY = click.option("--only", multiple=True, metavar="ID", help="Only this scene; may be repeated.")
AGAIN = ("failed", "changed")
ACCEPTED = ("edited", "lost-light", "small-disk")
COUNT = click.IntRange(1, 1_000_000_000)  # of what is computed one by one: more takes for ever
_METHOD, _RUN = "Method", "Run"
RENDER_SETTINGS = options(
    click.option(
        "--product",
        type=click.Choice(["itof", "transient", "both"]),
        help="itof: phasors and ground truth, a few MB a scene; transient, both (default): transients too.",
    ),
    click.option("--resolution", type=Size(), help="Image size instead of the preset's, same aspect ratio."),
    option(
        _METHOD,
        "--method",
        help="many-light (the default); batched: phasors of many scenes at once, 6 to 10 times as fast; "
        "path: slower, for any scene at all.",
    ),
    option(
        _METHOD, "--error", type=float, help="many-light, batched: wanted error of the hidden signal (0.01)."
    ),
    option(_METHOD, "--lights", type=COUNT, help="many-light: surface points, not --error."),
    option(
        _METHOD,
        "--spp",
        type=COUNT,
        help="path: paths per pixel (4096); the hidden signal's error is 10 to 15 / sqrt(spp).",
    ),
    option(_METHOD, "--max-bounces", type=click.IntRange(1, MOST_BOUNCES), help="Instead of the preset's."),
    option(_METHOD, "--device", type=DEVICES, help=DEVICE_HELP),
)
RENDER_RUN = options(
    option(
        _RUN, "--workers", type=click.IntRange(min=1), help="Processes (one a device), or --cluster jobs."
    ),
    option(
        _RUN,
        "--cluster",
        metavar="WHERE",
        help="Render on a Dask cluster: one that runs, like tcp://host:8786, or a dask-jobqueue file.",
    ),
    option(
        _RUN,
        "--again",
        multiple=True,
        type=click.Choice(AGAIN),
        help="Render scenes again that failed before, or that have changed settings; may be repeated.",
    ),
    option(
        _RUN,
        "--accept",
        multiple=True,
        type=click.Choice(ACCEPTED),
        help="Start although scenes are edited (from scene.json and the meshes), or hidden light arrives "
        "outside the time axis, or the disk looks too small; may be repeated.",
    ),
)
MASK_THRESHOLD = click.option(
    "--mask-threshold",
    type=Number(min=0, min_open=True),
    help="Smallest amplitude of a pixel that shows the object, instead of the run's.",
)
MASK_FROM = click.option(
    "--mask-from",
    type=click.Choice(["amplitude", "depth"]),
    help="What of the output says whether a pixel shows the object, instead of the run's.",
)
FOV = click.option(
    "--fov",
    "horizontal_fov_deg",
    type=Number(1, 170),
    help="Horizontal field of view of the camera, degrees. By default that of the file, its import or its "
    "dataset, else that of the training.",
)
RESCALE = click.option(
    "--rescale/--no-rescale",
    default=None,
    help="Bring each image's mean amplitude to that of the training scenes, or trust the unit of INPUT. By "
    "default .npz and .h5 are rescaled, .exr is not.",
)
FORCE = click.option(
    "--force",
    is_flag=True,
    help="Go on although the light is not that of the relay wall of RUN, or the field of view is another.",
)
