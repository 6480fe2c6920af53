"""Defaults of a fine-tuning on a stored dataset: its learning rate, and epochs by the number of scenes."""

from __future__ import annotations

from typing import Any, Final

from model.settings.run import RunSettings
from model.settings.train_settings import TrainSettings

# A network of many corners, tuned to another: MAE of 127 test scenes in cm; untuned 4.2. With 16 scenes after
# 3, 40 and 400 steps: 4.6, 3.8, 3.5 at a rate of 1e-3; 3.5, -, 3.4 at 3e-4 (3.4 after 100); 3.9, 3.7, 3.5 at
# 1e-4. With 171 scenes and 440 steps 3.1 at each rate (notebook/experiments.md, Fine-tuning on few scenes).
LEARNING_RATE: Final = 3e-4
LEAST_STEPS: Final = 200


def fine_tuning_course(settings: TrainSettings, scenes: int) -> dict[str, Any]:
    """Defaults of a fine-tuning on so many training scenes, as plain data.

    Few scenes are seen more often. The learning rate is too small to spoil what a few steps cannot repair.
    """
    scenes = min(scenes, settings.run.train_scenes or scenes)
    steps = -(-scenes // settings.optimiser.batch_size)
    epochs = max(RunSettings().max_epochs, -(-LEAST_STEPS // max(steps, 1)))
    return {
        "optimiser": {"learning_rate": LEARNING_RATE},
        "run": {"max_epochs": epochs, "patience": epochs},
    }
