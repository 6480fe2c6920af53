"""A valid file of every kind that the commands read, in one small folder."""

import shutil

import h5py
import numpy as np
import OpenEXR
import trimesh
from captures import steps, taps_of, write_sidecar
from exr_bytes import COMPRESSIONS
from night_commands import night_here
from scipy.io import savemat
from synthetic_dataset import write_synthetic_dataset
from training_runs import train_on_one_thread

from itof import read_image
from render.farm.claims import claimed
from scenegen import BadRender, FailureRecord, read_record, write_bad_render, write_failure

MESHES = ("ply", "stl", "obj", "off", "glb")
PRESET = """# Dataset of one scene.
[dataset]
count = 1
seed = 3
test_fraction = 0.2
[hidden_object]
shapes = {shapes}
composite_fraction = 0.0
size_m.sphere = [0.3, 0.3, 0.3]
[hidden_object.location_m]
x = [1.0, 1.3]
[relay_wall]
material = "rough"
roughness = [0.3, 0.5]
reflectance = 0.5
[camera]
width = 16
height = 12
horizontal_fov_deg = 60
[itof]
frequencies_hz = [20e6, 50e6, 60e6]
[transient]
bin_count = 200
bin_width_m = 0.05
max_bounces = 3
"""
RENDERED = """
[dataset]
count = 2
seed = 3
[camera]
width = 16
height = 12
[transient]
bin_count = 1000
"""
TRAINING = """# A small network.
extends = "default"
[network]
width = 2
[run]
max_epochs = 1
[optimiser]
batch_size = 3
learning_rate = 1e-3
schedule = "constant"
[augmentation.paper]
flip_columns = true
rotation_deg = 90.0
[input]
channels.kind = "residual"
"""
CLUSTER = """jobqueue:
  slurm:
    name: night
    cores: 16   # of a job
    processes: 4
    memory: 32GB
    walltime: "04:00:00"
    worker-extra-args: ["--lifetime", "225m"]
    log-directory: night-jobs
    job-extra-directives: []
"""


def write_samples(folder, render):
    """The template of `arena.Arena`: ``work`` with all samples, and ``victim``, which lies outside.

    Parameters
    ----------
    render : runs night-render with the given arguments (fixture ``render_here``).
    """
    work = folder / "work"
    work.mkdir()
    _write_rendered(work / "data", render)
    closed = write_synthetic_dataset(work / "closed", count=4, width=24, height=14)
    train_on_one_thread(closed, work / "run", max_epochs=1, schedule="constant")
    _write_measurements(work, closed)
    _write_frames(work)
    (work / "training.toml").write_text(TRAINING)
    (work / "cluster.yaml").write_text(CLUSTER)
    (work / "preset.toml").write_text(PRESET.format(shapes='["sphere", "cube"]'))
    _write_meshes(work)
    for words in (
        ("night-render", "status", "data"),  # which remembers hashes
        ("night-train", "closed", "--out", "new", "--preset", "training.toml", "--device", "cpu"),  # shards
        ("night-eval", "predict", "run", "itof.exr", "--out", "pred", "--device", "cpu"),
        ("night-eval", "run", "closed", "--out", "report", "--device", "cpu"),
    ):
        done = night_here(*words, cwd=work)
        assert done.returncode == 0, done.stderr
    shutil.rmtree(work / "new")
    _write_victim(folder / "victim", work)


def _write_rendered(data, render):
    """Two scenes: one is rendered with transients and was bad before; rendering the other one failed."""
    data.with_suffix(".toml").write_text(RENDERED)
    done = night_here("night-gen", "scenes", data, "--preset", data.with_suffix(".toml"))
    assert done.returncode == 0, done.stderr
    done = render(data, "--product", "both", "--lights", 256, "--device", "cpu")
    assert done.returncode == 0, done.stderr
    failed = data / "renders" / "000001"
    failure = FailureRecord(recipe=read_record(failed).recipe, attempts=3, reason="the worker was killed")
    for file in failed.iterdir():
        file.unlink()
    write_failure(failed, failure, "the worker was killed\n")
    record = read_record(data / "renders" / "000000")
    write_bad_render(data / "renders" / "000000", BadRender(record.recipe, record.files, ("a wrong check",)))
    with claimed(data.parent / "data" / "renders", "000001") as claim:
        claim.begin("a run")


def _write_measurements(work, closed):
    """Measurements in all forms: the closed form of scene 000000, and one to splice it with."""
    for scene_id, name in zip(closed.ids(), ("itof", "other"), strict=False):
        source = closed.render_folder(scene_id) / "itof.exr"
        shutil.copy(source, work / f"{name}.exr")
        phasors, frequencies_hz = read_image(source).phasors()
        arrays = {"phasors": phasors, "frequencies_hz": np.array(frequencies_hz), "reference": phasors}
        np.savez(work / f"{name}.npz", **arrays)
        with h5py.File(work / f"{name}.h5", "w") as file:
            for key, values in arrays.items():
                file[key] = values
    for compression in COMPRESSIONS:  # as other programs write it
        with OpenEXR.File(str(work / "itof.exr")) as file:
            file.header()["compression"] = getattr(OpenEXR, f"{compression}_COMPRESSION")
            file.write(str(work / f"{compression}.exr"))


def _write_frames(work):
    """Raw frames of the measurement in all forms, and their sidecar."""
    phasors = np.load(work / "itof.npz")["phasors"].astype(np.complex128)
    sidecar = write_sidecar(work / "camera.toml", dark_arrays=["dark"], calibration_file="dark.npz")
    raw = np.round(1e4 / np.abs(phasors).max() * taps_of(phasors, steps(4), steps(2)))[None]
    frames = np.concatenate([raw, raw + 1]).astype(np.uint16)
    np.savez(sidecar.with_name("dark.npz"), dark=np.zeros_like(raw))
    np.savez(work / "frames.npz", raw=frames)
    savemat(work / "frames.mat", {"raw": frames}, do_compression=True)
    with h5py.File(work / "frames.h5", "w") as file:
        file.create_dataset("raw", data=frames, chunks=(1, *frames.shape[1:]), compression="gzip")


def _write_meshes(work):
    """A mesh in each form, a preset that names it, and the dataset that was made with them."""
    solid = trimesh.creation.icosphere(subdivisions=1)
    for kind in MESHES:
        data = solid.export(file_type=kind)
        (work / f"mesh.{kind}").write_bytes(data if isinstance(data, bytes) else data.encode())
        preset = PRESET.format(shapes=f'["mesh:mesh.{kind}"]')
        (work / f"{kind}.toml").write_text(preset)
        done = night_here("night-gen", "scenes", f"made_{kind}", "--preset", f"{kind}.toml", cwd=work)
        assert done.returncode == 0, done.stderr


def _write_victim(victim, work):
    """What path traversal would reach: an innocent file, a measurement, a dataset folder."""
    victim.mkdir()
    (victim / "keep.txt").write_text("this file belongs to somebody else\n" * 100)
    shutil.copy(work / "itof.h5", victim / "secret.h5")
    shutil.copytree(work / "data" / "renders" / "000000", victim / "000000")
