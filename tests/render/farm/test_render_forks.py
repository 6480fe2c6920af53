"""A process that has rendered can be forked, as loaders of training data do."""

import multiprocessing

import numpy as np

from itof import read_image, write_image
from render.options import ManyLightOptions
from render.rendering import Renderer
from render.settings import RenderSettings

SPHERE = {
    "dataset": {"count": 1},
    "camera": {"width": 16, "height": 12},
    "hidden_object": {"shapes": ["sphere"], "composite_fraction": 0},
}


def copy_image(path, copy):
    write_image(copy, read_image(path).channels, {})


def test_a_process_forked_after_a_render_reads_and_writes_exr_files(make_dataset, tmp_path, variant):
    dataset = make_dataset(SPHERE)
    options = ManyLightOptions(lights=256)
    Renderer(dataset, RenderSettings(product="itof", options=options, device="cpu")).render("000000")
    image, copy = dataset.render_folder("000000") / "itof.exr", tmp_path / "copy.exr"
    child = multiprocessing.get_context("fork").Process(target=copy_image, args=(image, copy))
    child.start()
    child.join(600)
    hangs = child.is_alive()
    child.kill()
    assert not hangs
    assert child.exitcode == 0
    for name, values in read_image(image).channels.items():
        assert np.array_equal(read_image(copy).channels[name], values)
