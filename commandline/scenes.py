"""The commands of ``night-gen``: ``scenes``, ``corner`` and ``preview``."""

from __future__ import annotations

import functools
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from commandline.confirmation import YES, confirm_deletion
from commandline.endings import NightGroup
from commandline.options import FOLDER, chosen_scenes
from commandline.results import JSON, tell
from commandline.streams import say
from disk import read_settings
from processes import deferred_signals, showing_progress
from scenegen import Preset, leaks, open_dataset, preset_from_dict

PRESET = click.option(
    "--preset",
    help="Name in data/presets, or a .toml file.  [default: that of the dataset in OUT, or paper]",
)


@click.group(cls=NightGroup)
def night_gen() -> None:
    """Make look-behind-a-corner scenes in Blender."""


@night_gen.command(short_help="Make the scenes of a preset.")
@click.argument("out", type=FOLDER)
@PRESET
@click.option("--count", type=int, help="Number of scenes instead of the preset's.")
@click.option("--seed", type=int, help="Seed instead of the preset's.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Processes that make scenes, 350 MB each; the dataset is the same.",
)
@click.option("--replace", is_flag=True, help="Make a dataset in OUT again with another preset; asks first.")
@YES
def scenes(
    out: Path,
    preset: str | None,
    count: int | None,
    seed: int | None,
    workers: int,
    replace: bool,
    yes: bool,
) -> None:
    """Make the scenes of a preset in the folder OUT; a larger --count than before adds scenes.

    Damaged scenes are made again. A dataset in OUT brings its own preset; with --replace, another preset
    replaces its scenes and deletes its renders.
    """
    from scenegen.corner_check import refuse_impossible_corner
    from scenegen.making.datasets import blender_maker
    from scenegen.making.generation import generate
    from scenegen.making.generation_pool import generate_in_processes
    from scenegen.making.meshes import with_meshes
    from scenegen.making.replacing import losses
    from scenegen.making.target import check_target

    settings, preset_folder = _overridden_preset(out, preset, count, seed)
    settings, meshes = with_meshes(settings, preset_folder)
    refuse_impossible_corner(settings, meshes)
    hashes = {shape: mesh.sha256 for shape, mesh in meshes.items()}
    check_target(out, settings, hashes, replacing=replace)  # before Blender, which takes a second to load
    if replace and (lost := losses(out, settings, hashes)):
        confirm_deletion(lost, yes)
    make_maker = functools.partial(blender_maker, meshes)
    with showing_progress(settings.dataset.count, "scene", "scenes") as bar:
        if workers == 1:
            dataset = generate(out, settings, make_maker(), bar.update, meshes=hashes, replacing=replace)
        else:
            dataset = generate_in_processes(
                *(out, settings, make_maker, bar.update), workers=workers, meshes=hashes, replacing=replace
            )
    found = leaks(dataset.scene(scene_id) for scene_id in dataset.ids())
    if found:
        say(f"warning: the splits leak in {len(found)} places, for example: {found[0]}")
    click.echo(dataset.sentence())


@night_gen.command(short_help="Pictures, distances and light of a corner.")
@click.argument("preset")
@click.option(
    "--out",
    type=FOLDER,
    metavar="FILE",
    help="Plan and side view (.png), or page in 3-D (.html).  [default: PRESET_corner.png and .html]",
)
@JSON
def corner(preset: str, out: Path | None, as_json: bool) -> None:
    """Draw the corner of PRESET and say its distances and its hidden light, without making scenes.

    PRESET is a name in data/presets, or a .toml file. A corner that cannot be is drawn, too, and then
    refused.
    """
    from model.training.expectation import course_sentence
    from render.backend import BackendError
    from render.batch.expected_light import NO_LIGHT, expected_light
    from render.products.corner_facts import corner_facts
    from render.products.corner_figure import write_corner_figure
    from render.products.corner_page import write_corner_page
    from scenegen.corner_check import refuse_impossible_corner
    from scenegen.making.meshes import with_meshes

    data, origin = read_settings("presets", preset)
    settings = preset_from_dict(data, origin)
    writers = {".png": write_corner_figure, ".html": write_corner_page}
    files = [out] if out else [Path(f"{Path(origin).stem}_corner{ending}") for ending in writers]
    if out and out.suffix.lower() not in writers:
        raise click.BadParameter(f"{out} must end in {' or '.join(writers)}", param_hint="--out")
    settings, meshes = with_meshes(settings, Path(origin).parent)
    facts = corner_facts(settings, meshes)
    said, found = [*facts.sentences], {**facts.as_data(), "hidden_light": None}
    try:
        refuse_impossible_corner(settings, meshes)
        light = expected_light(settings, meshes)
        said.append(NO_LIGHT if light is None else light.sentence)
        if light is not None and not settings.is_sequence:
            said.append(course_sentence(100 * light.no_object_m, one_corner=settings.is_one_corner))
            said.append(f"`night-train --for {preset} --out RUN` makes it, and measures the time here first")
        found["hidden_light"] = None if light is None else light.as_data()
    except BackendError as error:
        said.append(f"hidden light: not computed, because {error}")
    finally:
        for file in files:
            writers[file.suffix.lower()](settings, facts, said, file)
        tell([*said, *(f"picture: {file}" for file in files)], found, as_json)


@night_gen.command(short_help="Contact sheet, plots and card of a dataset.")
@click.argument("dataset", type=FOLDER)
@click.option(
    "--count",
    type=click.IntRange(1, 100),
    default=12,
    show_default=True,
    help="Scenes on the contact sheet, even over classes and splits.",
)
@click.option("--only", multiple=True, metavar="ID", help="Only this scene on the sheet; may be repeated.")
@click.option("--licence", metavar="TEXT", help="Licence of the dataset, for its card; kept from then on.")
def preview(dataset: Path, count: int, only: tuple[str, ...], licence: str | None) -> None:
    """Draw a contact sheet and plots of DATASET, and write its card, README.md, and croissant.json."""
    from render.products import contact_sheet
    from render.products import preview as preview_files
    from scenegen.making.datasets import blender_maker

    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only) if only else contact_sheet.choose_scenes(opened, count)
    preview_files.check_preview(opened, ids, licence)  # before Blender, which takes a second to load
    maker = blender_maker(preview_files.meshes_in(opened, ids))
    steps = len(opened.ids()) + len(ids)
    with deferred_signals() as handle_signals, showing_progress(steps, "scene", "preview") as bar:

        def scene_done() -> None:
            bar.update()
            handle_signals()  # Blender loses an exception that comes while it renders

        written = preview_files.write_preview(opened, ids, maker.picture, licence, scene_done)
    for file in written:
        click.echo(f"{file}")
    if dataset / "README.md" not in written:
        say(f"{dataset / 'README.md'} is not ours and was left alone: rename it to get a dataset card")


def _overridden_preset(
    out: Path, preset: str | None, count: int | None, seed: int | None
) -> tuple[Preset, Path]:
    """The preset with what the command line gives instead of its own count and seed; its own folder.

    Where no preset is named, it is that of the dataset in `out`, or ``paper`` if there is none.
    """
    if preset is None and (out / "dataset.json").exists():
        data: dict[str, Any] = asdict(open_dataset(out).preset)
        origin = str(out / "dataset.json")
    else:
        data, origin = read_settings("presets", "paper" if preset is None else preset)
    changes = {key: value for key, value in (("count", count), ("seed", seed)) if value is not None}
    table = data.setdefault("dataset", {})
    if changes and isinstance(table, dict):
        table.update(changes)
    return preset_from_dict(data, origin), Path(origin).parent
