"""The shape of the house: imports go one way, between its rooms (packages) and between their wings."""

import ast
import graphlib
from functools import cache

import pytest
from source_tree import ROOMS, Import, imports, module_of, needed_by, sources

BASEMENT = {"disk", "processes"}
MAY_IMPORT = {
    "disk": set(),
    "processes": set(),
    "scenegen": BASEMENT,
    "itof": BASEMENT,
    "render": {"scenegen", "itof", *BASEMENT},
    "model": {"scenegen", "itof", *BASEMENT},
    "commandline": {"scenegen", "itof", "render", "model", *BASEMENT},
    "cli": {"commandline"},
    "night_nlos": {"commandline", "cli"},
}
# The batched engine, which these modules import inside functions: all else works without Mitsuba.
MAY_RENDER = {
    "model.training.fresh.workers": "render.batch.light",
    "model.refinement.light.corner_light": "render.batch.candidates",
}
# What each wing may import of its own room, when it is loaded and later. A wing is a package or a module.
WINGS = {
    "disk": set(),
    "processes": set(),
    "scenegen": set(),
    "scenegen.making": {"scenegen"},
    "itof": set(),
    "itof.exr": {"itof", "itof.pictures"},
    "itof.files": {"itof", "itof.exr"},
    "itof.sensor": {"itof"},
    "itof.wall": {"itof"},
    "itof.pictures": {"itof"},
    "itof.capture": {"itof", "itof.exr", "itof.files", "itof.wall", "itof.pictures", "itof.sensor"},
    "render": set(),
    "render.options": set(),
    "render.backend": set(),
    "render.settings": {"render.options", "render.backend"},
    "render.walls": set(),
    "render.transport.method": set(),
    "render.transport.film": set(),
    "render.transport.kernels": set(),
    "render.transport.lights": {"render.transport.kernels"},
    "render.transport.passes": {
        *(f"render.transport.{name}" for name in ("method", "film", "kernels", "lights")),
        "render.walls",
    },
    "render.transport": {
        "render.options",
        *(f"render.transport.{name}" for name in ("method", "film", "kernels", "lights", "passes")),
    },
    "render.batch": {
        *("render.backend", "render.walls", "render.transport.kernels", "render.transport.lights")
    },
    "render.edited_scenes": {"render.settings"},
    "render.render_files": {"render.settings"},
    "render.room_layer": {
        *("render.transport", "render.transport.method", "render.transport.lights", "render.settings")
    },
    "render.rendering": {
        *("render.room_layer", "render.render_files"),
        *("render.transport.method", "render.transport.lights", "render.transport.passes"),
        *("render.transport", "render.batch", "render.edited_scenes", "render.settings", "render.backend"),
        "render.options",
    },
    "render.farm.claims": set(),  # the locks of scenes, which products take too
    "render.farm": {
        *("render.rendering", "render.settings", "render.backend", "render.options"),
        *("render.edited_scenes", "render.farm.claims"),
    },
    "render.products": {"render.farm.claims", "render.settings", "render.options"},
    "render.pairs": set(),
    "render.mirror_panels": {"render.transport", "render.products", "render.settings", "render.backend"},
    "model": set(),
    "model.settings": set(),
    "model.device": {"model.settings"},
    "model.network": {"model.settings"},
    "model.run_folder": {"model.network", "model.settings"},
    "model.data": {"model.network", "model.settings"},
    "model.paper": {"model.data", "model.network", "model.settings"},
    "model.prediction": {"model.network", "model.run_folder", "model.device", "model.settings"},
    "model.refinement.light": {"model.network", "model.device", "model.settings"},
    "model.training": {
        *("model.refinement.light", "model.data", "model.network", "model.run_folder", "model.device"),
        *("model.paper", "model.settings"),
    },
    "model.judging": {
        *("model.prediction", "model.data", "model.network", "model.run_folder", "model.device"),
        "model.settings",
    },
    "model.judging.report": {"model.judging", "model.prediction", "model.network", "model.run_folder"},
    "model.judging.evaluation": {
        *("model.judging.report", "model.judging", "model.prediction", "model.data", "model.run_folder"),
        "model.settings",
    },
    "model.refinement": {
        *("model.refinement.light", "model.judging", "model.prediction", "model.data", "model.network"),
        *("model.run_folder", "model.device", "model.settings"),
    },
    "commandline": set(),
    "cli": set(),
    "night_nlos": set(),
}
BLENDER_FILES = "scenegen/making/blender"  # blender.py and blender_*.py
# Libraries that live in one place: where each may be imported.
HOME = {
    "mitsuba": "render/",
    "drjit": "render/",
    "mitransient": "render/",
    "torch": "model/",
    "click": ("cli.py", "commandline/"),
    "bpy": BLENDER_FILES,
    "bmesh": BLENDER_FILES,
    "mathutils": BLENDER_FILES,
    "OpenEXR": "itof/exr/library.py",
    "Imath": "itof/exr/library.py",
    "h5py": (
        *("render/products/deferred_error_file.py", "render/products/tal_export.py"),
        *("render/products/export_rows.py", "itof/files/hdf5_reading.py"),
        *("render/products/zarr_copy.py", "itof/files/measurement_writing.py"),
    ),
    "zarr": "render/products/zarr_copy.py",
    "numcodecs": "render/products/zarr_copy.py",
    "imageio_ffmpeg": ("render/products/movie_encoding.py", "itof/files/video_reading.py"),
    "dask": "render/farm/",
    "dask_jobqueue": "render/farm/",
    "distributed": "render/farm/",
    "tqdm": "processes/progress.py",
    "jinja2": "model/judging/report/page.py",
    "plotly": "model/judging/report/page.py",
    "onnx": "model/prediction/onnx_export.py",
    "onnxruntime": "model/prediction/onnx_export.py",
}


def wing_of(module):
    """The most precise entry of WINGS that a module belongs to."""
    return max((wing for wing in WINGS if f"{module}.".startswith(f"{wing}.")), key=len)


@cache
def arrows():
    """(importing, imported) modules of the program, each pair once."""
    return sorted(
        {
            (module, each.module)
            for module, found in imports().items()
            for each in found
            if each.module in imports()
        }
    )


def test_imports_follow_the_arrows_between_rooms():
    rooms = [(source, target, source.split(".")[0], target.split(".")[0]) for source, target in arrows()]
    assert [
        f"{source} imports {target}"
        for source, target, room, other in rooms
        if other != room and other not in MAY_IMPORT[room] and MAY_RENDER.get(source) != target
    ] == []


@pytest.mark.parametrize("module", MAY_RENDER)
def test_the_engine_is_imported_late(module):
    tree = sources()[f"{module.replace('.', '/')}.py"]
    found = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module.startswith("render")]
    assert found
    assert all(node.col_offset > 0 for node in found)


def test_imports_follow_the_arrows_between_wings():
    wings = [(source, target, wing_of(source), wing_of(target)) for source, target in arrows()]
    assert [
        f"{source} imports {target}"
        for source, target, wing, other in wings
        if source.split(".")[0] == target.split(".")[0]
        and source not in ROOMS  # the package itself offers the names of its modules
        and other not in {wing, *WINGS[wing]}
    ] == []


def test_every_entry_of_the_table_is_there_and_the_table_has_no_circle():
    assert {wing for wing in WINGS if wing not in imports()} == set()
    graphlib.TopologicalSorter(WINGS).prepare()


def test_no_modules_import_each_other_in_a_circle():
    sorter = graphlib.TopologicalSorter()
    for source, target in arrows():
        sorter.add(source, target)
    sorter.prepare()  # CycleError names a circle


def test_scenes_are_made_by_the_commands_alone():
    outside = [
        (source, target)
        for source, target in arrows()
        if target.startswith("scenegen.making.")
        and not source.startswith(("scenegen.making.", "commandline"))
    ]
    # The meshes of finished scenes are read for the preview; that module does not need Blender.
    assert outside == [("render.products.preview", "scenegen.making.meshes")]


@pytest.mark.parametrize(
    ("module", "machinery"),
    [
        (
            "model.settings",
            ("model.data", "model.device", "model.network", "model.prediction", "model.training"),
        ),
        ("itof.sensor.cameras", ("itof.exr", "itof.wall")),
        ("model.prediction.predictor", ("model.data", "model.training", "model.judging")),
        ("model.prediction.prediction_files", ("model.data", "model.training", "model.judging")),
        ("model.prediction.onnx_export", ("model.data", "model.training", "model.judging")),
        ("itof.capture.sidecar", ("itof.files", "itof.wall", "itof.exr")),
        ("render.settings", ("render.transport", "render.rendering", "render.farm", "render.products")),
        ("render.farm.plan", ("render.transport", "render.rendering", "render.products")),
    ],
)
def test_what_is_light_needs_no_machinery(module, machinery):
    assert sorted(needed for needed in needed_by(module) if needed.startswith(machinery)) == []


def test_each_heavy_library_lives_in_its_one_place():
    wrong = [
        f"{file} imports {each.module}"
        for file in sources()
        for each in imports()[module_of(file)]
        if not file.startswith(HOME.get(each.module.split(".")[0], ""))
    ]
    assert wrong == []


def imports_of_blender(found):
    return {each for each in found if each.module.startswith("scenegen.making.blender")}


def test_the_blender_files_are_imported_late_and_by_night_gen_alone():
    users = [
        (file, each)
        for file in sources()
        if not file.startswith(BLENDER_FILES)
        for each in imports_of_blender(imports()[module_of(file)])
    ]
    assert users == [("scenegen/making/datasets.py", Import("scenegen.making.blender", when_loaded=False))]


def test_blender_is_loaded_in_one_place():
    loading = [
        file
        for file in sources()
        if {each.module.split(".")[0] for each in imports()[module_of(file)]} & {"bpy", "bmesh", "mathutils"}
    ]
    assert loading == ["scenegen/making/blender_start.py"]  # this file first sets Blender's settings folder
