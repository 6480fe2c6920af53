"""Settings of a training from the command line: a preset, the run to go on with, and options."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from model import TrainSettings


def chosen_settings(out: Path, resume: bool, preset: str | None, **options: Any) -> TrainSettings:
    """Settings of the run in `out` if it is resumed, then those of the preset, then the given options."""
    import model

    before = model.run_settings(out) if resume else {}
    named = preset or (None if resume else "default")
    data, origin = model.training_preset(named) if named else ({}, "options")
    given = {name: value for name, value in options.items() if value is not None}
    model.settings_from_dict(given, "options")  # what is wrong with them is not the preset's fault
    return model.settings_from_dict(before | data | given, origin)
