"""What a worker of ``night-render`` does first, as a command: it loads a scene, and its mirrored scene."""

from pathlib import Path

import click

from commandline.endings import NightCommand


@click.command(cls=NightCommand)
@click.argument("dataset", type=Path)
@click.argument("scene")
def load_scene(dataset, scene):
    """Load a scene into Mitsuba."""
    from render.backend import select_variant
    from render.transport.scene_loading import load_scene
    from scenegen import open_dataset

    select_variant("cpu")
    for is_mirrored in (False, True):
        shapes = load_scene(open_dataset(dataset), scene, mirrored=is_mirrored).shapes()
        click.echo(f"{len(shapes)} shapes")
