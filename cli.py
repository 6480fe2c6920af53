"""The four commands: ``night-gen``, ``night-render``, ``night-train``, ``night-eval``.

Whatever is wrong with the input becomes one sentence on stderr and exit code 2. Set ``NIGHT_TRACEBACK=1``
to see where an error came from.
"""

from __future__ import annotations

import functools
import logging
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

import scenegen
from scenegen import Preset

DEVICE = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    show_default=True,
    help="Where to compute; auto takes a GPU if there is one.",
)
FOLDER = click.Path(path_type=Path)


class Refusal(click.ClickException):
    """A one-sentence error with exit code 2."""

    exit_code = 2


def refusing(command: Callable[..., None]) -> Callable[..., None]:
    """Turn the errors that input can cause into one sentence; leave the rest of click as it is."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        logging.basicConfig(level=logging.INFO, format="%(message)s")
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that `finally` runs
        try:
            command(*args, **kwargs)
        except (ValueError, RuntimeError, ArithmeticError, MemoryError, OSError) as error:
            # click's own exceptions are RuntimeErrors that it knows how to show.
            if isinstance(error, click.exceptions.Exit | click.ClickException | click.Abort):
                raise
            if os.environ.get("NIGHT_TRACEBACK"):
                raise
            raise Refusal(_sentence(error)) from None

    return wrapped


@click.group()
@click.version_option(package_name="night-nlos")
def night_gen() -> None:
    """Make look-behind-a-corner scenes in Blender."""


@night_gen.command()
@click.argument("out", type=FOLDER)
@click.option("--preset", default="paper", show_default=True, help="Name in data/presets, or a .toml file.")
@click.option("--count", type=int, help="Number of scenes instead of the preset's.")
@click.option("--seed", type=int, help="Seed instead of the preset's.")
@refusing
def scenes(out: Path, preset: str, count: int | None, seed: int | None) -> None:
    """Make the scenes of a preset in the folder OUT."""
    from scenegen.generation import check_target, generate

    settings = _overridden(preset, count, seed)
    check_target(out, settings)  # before Blender, which takes a second to load
    from scenegen.blender import BlenderMaker

    with tqdm(total=settings.dataset.count, unit="scene", desc="scenes", disable=None) as bar:
        dataset = generate(out, settings, BlenderMaker(), lambda: bar.update())
    found = scenegen.leaks(dataset.scene(scene_id) for scene_id in dataset.ids())
    if found:
        click.echo(f"warning: the splits leak in {len(found)} places, for example: {found[0]}", err=True)
    parts = [f"{len(dataset.ids(split))} {split}" for split in ("train", "validation", "test")]
    click.echo(f"{len(dataset.ids())} scenes in {out}: {', '.join(parts)}")


@click.command()
@click.argument("dataset", type=FOLDER)
@click.option("--method", help="many-light (the default), or path: slower, for any scene at all.")
@click.option(
    "--product",
    type=click.Choice(["itof", "transient", "both"]),
    default="both",
    show_default=True,
    help="itof: phasors and ground truth, a few MB a scene; else transients as well.",
)
@click.option("--error", type=float, help="many-light: wanted error of the hidden signal (0.01).")
@click.option("--lights", type=click.IntRange(min=1), help="many-light: surface points, instead of --error.")
@click.option(
    "--spp",
    type=click.IntRange(min=1),
    help="path: paths per pixel (4096); the hidden signal's error is 10 to 15 / sqrt(spp).",
)
@click.option("--max-bounces", type=click.IntRange(min=1), help="Instead of the preset's.")
@DEVICE
@click.option("--resolution", metavar="WxH", help="Image size instead of the preset's, same aspect ratio.")
@click.option("--only", multiple=True, metavar="ID", help="Render only this scene; may be repeated.")
@click.version_option(package_name="night-nlos")
@refusing
def night_render(
    dataset: Path,
    product: Any,
    device: Any,
    resolution: str | None,
    only: tuple[str, ...],
    max_bounces: int | None,
    method: str | None,
    **method_options: Any,
) -> None:
    """Render what the camera measures of every scene in DATASET; what is already rendered is kept."""
    import render

    opened = scenegen.open_dataset(dataset)
    ids = [opened.entry(scene_id).id for scene_id in dict.fromkeys(only)] or opened.ids()
    given = {name: value for name, value in method_options.items() if value is not None}
    settings = render.RenderSettings(
        method=method or render.DEFAULT_METHOD,
        product=product,
        options=render.MethodOptions(**given),
        max_bounces=max_bounces,
        device=device,
        resolution=_size(resolution),
    )
    renderer = render.Renderer(opened, settings)
    missing = [scene_id for scene_id in ids if not renderer.is_done(scene_id)]
    _say_space(
        dataset, len(missing), renderer.layout.width * renderer.layout.height * renderer.layout.bin_count
    )
    for scene_id in tqdm(missing, unit="scene", desc=f"render ({renderer.variant})", disable=None):
        renderer.render(scene_id)
    click.echo(f"{len(missing)} scenes rendered, {len(ids) - len(missing)} were there; {dataset / 'renders'}")


@click.command()
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Run folder to write.")
@click.option("--preset", help="Training settings: a name in data/training, or a .toml file.")
@click.option("--channels", help="Network input: paper, residual or paper+residual.")
@click.option("--width", type=click.IntRange(min=1), help="Channels of the U-Net's first level.")
@click.option("--loss", help="What the MAE is taken on: components or depth.")
@click.option("--alpha", type=click.FloatRange(min=0), help="Weight of the object in the loss.")
@click.option("--learning-rate", type=click.FloatRange(min=0, min_open=True), help="Adam's step.")
@click.option("--batch-size", type=click.IntRange(min=1), help="Scenes a step.")
@click.option("--max-epochs", type=click.IntRange(min=1), help="Longest training.")
@click.option("--patience", type=click.IntRange(min=1), help="Epochs without a better validation loss.")
@click.option("--augmentations", help="Of the training scenes: none, flip or paper.")
@click.option("--noise-sigma", type=click.FloatRange(min=0), help="Sensor noise, in 20 MHz amplitudes.")
@click.option("--seed", type=click.IntRange(min=0), help="Of weights, order and augmentation.")
@DEVICE
@click.option("--resume", is_flag=True, help="Go on with the run in --out, by its own settings.")
@click.version_option(package_name="night-nlos")
@refusing
def night_train(dataset: Path, out: Path, preset: str | None, resume: bool, **options: Any) -> None:
    """Train a network on the renders of DATASET; options override the preset."""
    import model

    opened = scenegen.open_dataset(dataset)
    before = model.run_settings(out) if resume else {}
    data, origin = scenegen.read_settings("training", preset) if preset else ({}, "options")
    given = {name: value for name, value in options.items() if value is not None}
    settings = model.settings_from_dict(before | data | given, origin)
    result = model.train(opened, out, settings, resume=resume)
    click.echo(
        f"{result.epochs} epochs, ended by {result.ended_by}; best validation loss "
        f"{result.best_validation_loss:.4f} in epoch {result.best_epoch}; run in {out}"
    )


@click.command()
@click.argument("run", type=FOLDER)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Report folder to write.")
@click.option(
    "--split", type=click.Choice(["train", "validation", "test"]), default="test", show_default=True
)
@DEVICE
@click.version_option(package_name="night-nlos")
@refusing
def night_eval(run: Path, dataset: Path, out: Path, split: Any, device: Any) -> None:
    """Judge the network of RUN against the ground truth of DATASET."""
    import model

    report = model.evaluate(run, scenegen.open_dataset(dataset), out, split=split, device=device)
    click.echo(report.table)
    click.echo(f"figures and point clouds in {out}")


def _overridden(preset: str, count: int | None, seed: int | None) -> Preset:
    """The preset with what the command line gives instead of its own count and seed."""
    data, origin = scenegen.read_settings("presets", preset)
    changes = {key: value for key, value in (("count", count), ("seed", seed)) if value is not None}
    table = data.setdefault("dataset", {})
    if changes and isinstance(table, dict):
        table.update(changes)
    return scenegen.preset_from_dict(data, origin)


def _size(resolution: str | None) -> tuple[int, int] | None:
    if resolution is None:
        return None
    match = re.fullmatch(r"(\d+)x(\d+)", resolution)
    if match is None:
        raise click.BadParameter(
            f"{resolution!r} is no image size; write it like 160x120", param_hint="--resolution"
        )
    return int(match[1]), int(match[2])


def _say_space(dataset: Path, scenes: int, values: int) -> None:
    """Say before starting what transients may take, when it is much."""
    upper_bytes = 2 * 4 * values * scenes  # scene and mirrored scene, float32, before compression
    free_bytes = shutil.disk_usage(dataset).free
    if upper_bytes > min(free_bytes, 10e9):
        click.echo(
            f"note: the transients of {scenes} scenes are {upper_bytes / 1e9:.2g} GB before compression, and "
            f"{free_bytes / 1e9:.2g} GB are free; they shrink to 5 to 40 % of that, and --product itof needs "
            "a few MB a scene",
            err=True,
        )


def _sentence(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    if isinstance(error, MemoryError):
        return f"out of memory {error}".strip() + ": use a smaller resolution, batch or bin_count"
    return " ".join(str(error).split()) or type(error).__name__
