"""Shared real things: a running Blender, a Mitsuba variant, and small datasets made with them."""

import gc
import shutil
import signal
import tomllib

import exported_scene
import many_light_scenes
import previews
import pytest
from dask_processes import dask_processes
from night_commands import PRESET, TRAINING, Pipeline, night, night_here
from render_runs import SETTINGS

from itof import TransientReader
from scenegen import load_preset, open_dataset, preset_from_dict

gc.disable()  # until the tests are collected: no garbage arises, and to look for it takes a third of the time

# What a script starts with & ignores Ctrl-C, and so would the commands that these tests start.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)  # of the tests that -m has left
def pytest_collection_modifyitems(items):
    """Files that need the same things that take long to make follow each other: renders, pipeline, report.

    Of two processes, each of which runs a stretch of the tests, one makes all of them. The one that is done
    first takes tests from the end of the other's stretch.
    """
    needs = {}
    for item in items:
        needs.setdefault(item.path, set()).update(item.fixturenames)

    def place(item):
        shared = ("render_cluster" in needs[item.path], "judged_run" in needs[item.path])
        return not any(shared), not shared[0], "pipeline" in needs[item.path]

    items.sort(key=place)
    gc.freeze()  # what is imported stays; to look for garbage in it takes 0.3 s each time
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish():
    """One search for garbage in place of the ten with which pytest ends."""
    gc.collect()
    gc.freeze()


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
def render_cluster(tmp_path_factory):
    """Address of a Dask cluster of two worker processes, which keep Mitsuba loaded between runs."""
    workers = ["--nworkers", "2", "--nthreads", "1"]
    with dask_processes(tmp_path_factory.mktemp("cluster"), workers) as (address, _):
        yield address


@pytest.fixture(scope="session")
def render_here(render_cluster):
    """Run ``night-render`` in this process; the workers of `render_cluster` render."""
    return lambda *arguments: night_here("night-render", *arguments, "--cluster", render_cluster)


@pytest.fixture(scope="session")
def seven_scenes(make_dataset):
    """Folder of the seven scenes of `night_commands.PRESET`, none rendered; for reading only."""
    return make_dataset(tomllib.loads(PRESET)).root


@pytest.fixture(scope="session")
def seven_renders(render_here, seven_scenes, tmp_path_factory):
    """Folder of these scenes, rendered by one undisturbed command; for reading only."""
    data = tmp_path_factory.mktemp("seven") / "data"
    shutil.copytree(seven_scenes, data)
    done = render_here(data, *SETTINGS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("7 scenes rendered, 0 were there")
    return data


@pytest.fixture(scope="session")
def exported(seven_renders, tmp_path_factory):
    """These scenes as one HDF5 file of ``night-render export``; for reading only."""
    out = tmp_path_factory.mktemp("export") / "new" / "seven.h5"
    done = night_here("night-render", "export", seven_renders, "--out", out)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def unrendered(seven_scenes, tmp_path):
    """Copy of the seven scenes, to be rendered."""
    return shutil.copytree(seven_scenes, tmp_path / "data")


@pytest.fixture
def rendered_copy(seven_renders, tmp_path):
    """Copy of the seven rendered scenes, to be changed; the log of their run is left out."""
    return shutil.copytree(seven_renders, tmp_path / "data", ignore=shutil.ignore_patterns("*.log"))


@pytest.fixture
def three_missing(rendered_copy):
    """Copy of the seven scenes of which the last three are not rendered yet."""
    for scene_id in ("000004", "000005", "000006"):
        shutil.rmtree(rendered_copy / "renders" / scene_id)
    return rendered_copy


@pytest.fixture(scope="session")
def closed_form_scenes(tmp_path_factory):
    """Twelve scenes and renders made from closed forms; for reading only."""
    from synthetic_dataset import write_synthetic_dataset

    return write_synthetic_dataset(tmp_path_factory.mktemp("closed_form"), count=12)


@pytest.fixture(scope="session")
def shards(closed_form_scenes):
    from model.data.shards import open_shards

    return open_shards(closed_form_scenes)


@pytest.fixture(scope="session")
def phasors(shards):
    """(3, H, W, F) phasors of the first closed-form scenes."""
    return shards.read([0, 1, 2]).phasors


@pytest.fixture(scope="session")
def exr(closed_form_scenes):
    """Measurement of the first closed-form scene, as a file."""
    return closed_form_scenes.render_folder(closed_form_scenes.ids()[0]) / "itof.exr"


@pytest.fixture(scope="session")
def finished_run(closed_form_scenes, tmp_path_factory):
    """Run folder of two epochs of `training_runs.settings()` on these scenes; for reading only."""
    from training_runs import train_on_one_thread

    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("runs") / "finished")


@pytest.fixture(scope="session")
def judged_run(finished_run, closed_form_scenes, tmp_path_factory):
    """A report of that run on its training scenes, and its folder; for reading only."""
    from model.device import one_thread
    from model.judging.evaluation import evaluate

    folder = tmp_path_factory.mktemp("reports") / "report"
    options = {"split": "train", "device": "cpu", "progress": False}
    with one_thread():  # as in the tests that compare with it
        return evaluate(finished_run, closed_form_scenes, folder, **options), folder


@pytest.fixture
def finished_copy(finished_run, tmp_path):
    """Copy of that run, to be changed."""
    return shutil.copytree(finished_run, tmp_path / "run")


@pytest.fixture(scope="session")
def seeing_run(closed_form_scenes, tmp_path_factory):
    """Run folder of a network that has learnt enough to show objects; for reading only."""
    from training_runs import SEEING, train_on_one_thread

    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("runs") / "seeing", **SEEING)


@pytest.fixture
def corners(rendered_copy, maker):
    """Nine scenes, of which `previews.RENDERED` are rendered, to be changed."""
    from scenegen.making.generation import generate

    root = rendered_copy.rename(rendered_copy.with_name("corners"))
    nine = PRESET.replace("count = 7", "count = 9")
    dataset = generate(root, preset_from_dict(tomllib.loads(nine), "nine"), maker, lambda: None)
    for scene_id in set(dataset.ids()) - set(previews.RENDERED):
        shutil.rmtree(dataset.render_folder(scene_id), ignore_errors=True)
    return dataset


@pytest.fixture(scope="session")
def transient_dataset(make_dataset, variant):
    """Two scenes of `exported_scene.PRESET`: 000000 is rendered with transients, 000001 is not rendered."""
    from render.options import ManyLightOptions
    from render.rendering import Renderer
    from render.settings import RenderSettings

    dataset = make_dataset(exported_scene.PRESET)
    settings = RenderSettings(product="both", options=ManyLightOptions(lights=256), device="cpu")
    Renderer(dataset, settings).render("000000")
    return dataset


@pytest.fixture
def transient_copy(transient_dataset, tmp_path):
    """Copy of these scenes, to be changed."""
    return open_dataset(shutil.copytree(transient_dataset.root, tmp_path / "copy"))


@pytest.fixture(scope="session")
def transient_bins(transient_dataset):
    """(H, W, T) the transient of scene 000000."""
    with TransientReader(transient_dataset.render_folder("000000") / "transient.exr") as reader:
        return reader.read_rows(0, exported_scene.HEIGHT)


@pytest.fixture(scope="session")
def four_shapes(make_dataset, variant):
    """The scenes named in `many_light_scenes.SHAPES`, loaded from the files that night-gen writes."""
    from render.transport.scene_loading import load_scene

    return {
        name: load_scene(make_dataset(preset), "000000") for name, preset in many_light_scenes.SHAPES.items()
    }


@pytest.fixture(scope="session")
def pipeline(seven_renders, tmp_path_factory):
    """Folder with a dataset, a run and a report, made by the four commands, for reading only.

    night-render is a process of its own, with a worker. It goes on with a run that has rendered six scenes.
    """
    folder = tmp_path_factory.mktemp("pipeline")
    (folder / "small.toml").write_text(PRESET)
    data, run, report = folder / "data", folder / "run", folder / "report"
    gen = night_here("night-gen", "scenes", data, "--preset", folder / "small.toml")
    shutil.copytree(seven_renders / "renders", data / "renders", ignore=shutil.ignore_patterns("000006"))
    done = [
        gen,
        night("night-render", data, "--workers", 1, "--device", "cpu"),
        night_here("night-train", data, "--out", run, *TRAINING, "--device", "cpu"),
        night_here("night-eval", run, data, "--split", "test", "--out", report, "--device", "cpu"),
    ]
    for command in done:
        assert command.returncode == 0, command.stderr
    return Pipeline(folder, *done)


@pytest.fixture
def pipeline_copy(pipeline, tmp_path):
    """Folder with copies of that dataset and run, to be changed."""
    for name in ("data", "run"):
        shutil.copytree(pipeline.folder / name, tmp_path / name)
    return tmp_path


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
