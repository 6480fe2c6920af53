"""The configuration of a run: constants of input, output and loss by the training scenes."""

from __future__ import annotations

import logging
from dataclasses import replace
from importlib.metadata import version

from disk.checksums import ZEROS
from itof.wall.wall_view import WallPlaceError
from model.data.channel_scaling import fit_input_spec, largest_shift_m
from model.data.corner import many_corners_problem, wall_view
from model.data.object_depth import BalanceError, background_per_object, object_depth_m
from model.data.shards import Shards
from model.network.channels import ChannelError
from model.run_folder.run_config import RunConfig, run_id_of
from model.settings.fresh import FreshScenes
from model.settings.train_settings import TrainSettings
from model.training.fine_tuning import Start
from model.training.refusals import TrainingError, output_frequency_hz
from model.training.state import rows_of
from scenegen import Dataset

_log = logging.getLogger(__name__)


def configure(
    dataset: Dataset,
    shards: Shards,
    settings: TrainSettings,
    before: RunConfig | None,
    start: Start | None,
    fresh: FreshScenes | None,
) -> RunConfig:
    """Contents of ``run.json``; a resumed run keeps its id and its constants, to the bit."""
    manifest, rows, chosen = shards.manifest, rows_of(shards, "train", settings), settings.input
    output_hz = before.output_frequency_hz if before else output_frequency_hz(dataset, settings, fresh)
    try:
        known = before.inputs if before else start.inputs(dataset, output_hz) if start else None
        if known:
            inputs = known
            if inputs.shows_wall and not before:
                if settings.run.progress:
                    _log.info("fitting the wall of the training scenes")
                shift_m = largest_shift_m(inputs, shards, rows, wall_view(dataset))
                inputs = replace(inputs, largest_shift_m=shift_m)
        else:
            inputs = fit_input_spec(
                *(chosen.channels.kind, shards, rows, chosen.frequencies_hz, chosen.amplitude_divisor),
                reference=chosen.reference,
                view=wall_view(dataset),
            )
        balance = before.background_per_object if before else None
        if settings.balances_dataset and balance is None:
            balance = background_per_object(shards, rows)
        depth_m = before.object_depth_m if before else start.config.object_depth_m if start else None
        if settings.predicts_probability and depth_m is None:
            depth_m = object_depth_m(shards, rows)
    except (BalanceError, ChannelError, WallPlaceError) as error:
        raise TrainingError(f"{dataset.root}: {error}") from None
    problem = many_corners_problem(dataset, inputs)
    if problem:
        raise TrainingError(problem)
    views_deg = [*manifest.fields_of_view_deg, *(fresh.fields_of_view_deg if fresh else ())]
    config = RunConfig(
        settings=settings,
        inputs=inputs,
        output_frequency_hz=output_hz,
        geometry=wall_view(dataset),
        image_width=manifest.width,
        image_height=manifest.height,
        preset_sha256=manifest.preset_sha256,
        data_sha256=manifest.data_sha256,
        night_version=version("night-nlos"),
        run_id=ZEROS,
        background_per_object=balance if settings.balances_dataset else None,
        object_depth_m=depth_m if settings.predicts_probability else None,
        started_from=before.started_from if before else start.origin if start else None,
        fresh=fresh,
        fields_of_view_deg=(min(views_deg), max(views_deg)) if views_deg else None,
    )
    return replace(config, run_id=before.run_id if before else run_id_of(config))
