"""The network that comes with the program and is the best one to start from, for the scenes of a preset."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log
from pathlib import Path

from disk.frequency_text import megahertz
from model.run_folder.networks import Network
from model.run_folder.run_config import RunConfig, read_config
from model.run_folder.shipped import shipped_runs
from model.training.refusals import represented_frequency_hz
from scenegen import Preset

_LARGEST_BLOCK = 64  # pixels, of `NetworkSettings`


@dataclass(frozen=True)
class Nearest:
    """What a training on the scenes of a preset starts from.

    Attributes
    ----------
    run : run folder of a network; None for new weights.
    block : pixels a side of a position of its U-Net, for the images of the preset; 0 without a network.
    frequencies_hz : modulation frequencies that it will see, Hz.
    why : the reason, as a sentence without a full stop.
    """

    run: Path | None
    block: int
    frequencies_hz: tuple[float, ...]
    why: str


def nearest_network(preset: Preset, *, has_sensor: bool) -> Nearest:
    """The shipped network for images of the shape of a preset's, and for as many corners, or for any.

    Of several, it is one that was trained for a camera, if this one is (`has_sensor`): others see nothing
    behind one; one that knows the frequencies, else all may be others (`model.training.other_images`); one
    for as many corners; one of the size of the images, or of the nearest whole part or multiple of it; and
    the one with the smallest error.
    """
    camera, hz = preset.camera, preset.itof.frequencies_hz
    size, corner = f"{camera.width}x{camera.height} pixels", preset.is_one_corner
    found = {name: read_config(run) for name, run in shipped_runs().items()}
    of_size = {n: each for n, each in found.items() if _block(each, preset)}
    fitting = {
        n: each for n, each in of_size.items() if each.inputs.shows_rays or each.inputs.shows_wall != corner
    }
    fitting = {n: each for n, each in fitting.items() if _knows(each, preset) or _is_at_others(each, preset)}
    if not fitting:
        lack = size if not of_size else "such depths and corners"
        return Nearest(
            None, 0, hz, f"the training starts from new weights: no network of NIGHT is for {lack}"
        )

    def rank(name: str) -> tuple[bool, bool, bool, float, bool, float]:
        each = fitting[name]
        network = Network.of(shipped_runs()[name], each)
        error_cm, is_other = network.validation_mae_cm or inf, network.is_of_camera != has_sensor
        other_size = 0.0 if network.any_size else abs(log(camera.width / each.image_width))
        other_corners = each.inputs.shows_wall == corner
        knows = _knows(each, preset)
        return has_sensor and is_other, not knows, other_corners, other_size, is_other, error_cm

    name = min(fitting, key=rank)
    config, knows = fitting[name], _knows(fitting[name], preset)
    corners = "many corners" if config.inputs.shows_wall else "one corner"
    own = f"{config.image_width}x{config.image_height} pixels"
    part = "a whole part" if config.image_width < camera.width else "a multiple"
    where = f"images of {own}" + ("" if own == size else f", {part} of {size}")
    where = "images of several sizes" if config.inputs.shows_rays else where
    own_hz = config.inputs.frequencies_hz
    why = f"the training starts from {name}, which is for {corners}, {megahertz(*own_hz)} and {where}"
    why += "" if knows else f"; {megahertz(*hz)} begin with the weights of the nearest of these"
    return Nearest(shipped_runs()[name], _block(config, preset), own_hz if knows else hz, why)


def _knows(config: RunConfig, preset: Preset) -> bool:
    """Whether the network can be used at frequencies of a preset, and its depths."""
    hz = preset.itof.frequencies_hz
    return {*config.inputs.frequencies_hz} <= {
        *hz
    } and config.output_frequency_hz == represented_frequency_hz(hz[0], [preset])


def _is_at_others(config: RunConfig, preset: Preset) -> bool:
    return set(config.inputs.frequencies_hz) != set(preset.itof.frequencies_hz)


def _block(config: RunConfig, preset: Preset) -> int:
    """The block with which the network has as many positions for a preset's images; 0 if there is none."""
    if config.inputs.shows_rays:
        return config.settings.network.block
    camera, own = preset.camera, config.settings.network.block
    block, rest = divmod(own * camera.width, config.image_width)
    same_shape = camera.width * config.image_height == camera.height * config.image_width
    is_whole = rest == 0 < block <= _LARGEST_BLOCK and 0 in (block % own, own % block)
    return block if same_shape and is_whole else 0
