"""Draws of scenes that are possible, and presets that have none."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import chain
from typing import Final

from disk.night_error import NightError
from scenegen.preset import Preset
from scenegen.sampling import first_of_each_class, sample_scene
from scenegen.scene import Scene, scene_id

MAX_ATTEMPTS = 1000
_SOUGHT: Final = 1000  # first scenes of a dataset, of whose classes one each is drawn before it is made
Refusal = Callable[[Scene], str | None]  # None for a possible scene, else the reason


class SamplingError(NightError):
    """No sample of a scene fits behind the middle wall."""


def sample_valid_scene(preset: Preset, index: int, refusal: Refusal) -> Scene:
    """The first draw of scene `index` that is possible.

    Parameters
    ----------
    refusal : returns None for a possible scene, else the reason.

    Raises
    ------
    SamplingError : none of 1000 draws is possible; the preset's ranges leave no room.
    """
    reason = ""
    for attempt in range(MAX_ATTEMPTS):
        scene = sample_scene(preset, index, attempt)
        refused = refusal(scene)
        if refused is None:
            return scene
        reason = refused
    raise SamplingError(
        f"scene {index}: none of {MAX_ATTEMPTS} draws fits the room (the last: {reason}); "
        "widen location_m or make the object smaller"
    )


def possible_scenes(preset: Preset, refusal: Refusal) -> Callable[[int], Scene]:
    """What gives the possible scene of each index. All frames of a sequence are of the same draw.

    Raises
    ------
    SamplingError : no draw of a sequence is possible in all frames; as `sample_valid_scene`, when called.
    """
    if not preset.is_sequence:
        return partial(sample_valid_scene, preset, refusal=refusal)
    count, frame, reason = preset.dataset.count, 0, ""
    for attempt in range(MAX_ATTEMPTS):
        # First the frame in which the draw before was impossible: often, all others are, too.
        for index in chain([frame], range(count)):
            refused = refusal(sample_scene(preset, index, attempt))
            if refused is not None:
                frame, reason = index, refused
                break
        else:
            return partial(sample_scene, preset, attempt=attempt)
    seconds = frame / (preset.dataset.frame_rate_hz or 1)
    raise SamplingError(
        f"frame {scene_id(frame)}, {seconds:.4g} s after the first: {reason}, and no other of {MAX_ATTEMPTS} "
        f"draws fits all {count} frames: change path_m or path_deg of [[object]], or make the object smaller"
    )


def refuse_impossible_objects(preset: Preset, refusal: Refusal) -> None:
    """Refuse a preset with a class of scenes of which no draw is possible, or with such a sequence.

    Raises
    ------
    SamplingError : the first such scene, or frame, and its object.
    """
    scene = possible_scenes(preset, refusal)
    for index in [] if preset.is_sequence else first_of_each_class(preset, _SOUGHT):
        scene(index)
