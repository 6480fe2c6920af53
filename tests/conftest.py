"""Shared real things: a running Blender, a Mitsuba variant, and small datasets made with them."""

import pytest

from scenegen import load_preset, preset_from_dict


@pytest.fixture(scope="session")
def maker():
    from scenegen.making.blender import BlenderMaker

    return BlenderMaker()


@pytest.fixture(scope="session")
def make_dataset(maker, tmp_path_factory):
    """Make a real dataset from the keys of a preset; everything else has the paper's value."""
    from scenegen.making.generation import generate

    def make(data):
        return generate(
            tmp_path_factory.mktemp("dataset"), preset_from_dict(data, "test"), maker, lambda: None
        )

    return make


@pytest.fixture(scope="session")
def variant():
    from render.backend import select_variant

    return select_variant("cpu")


@pytest.fixture(scope="session")
def paper():
    return load_preset("paper")


@pytest.fixture(scope="module")
def one_thread():
    """Images this small are slower on several threads, and much slower beside other work."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
