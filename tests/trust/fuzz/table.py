"""Every kind of file that the commands read, and the command that reads it."""

import forging
from damage import ANY_BYTES, ANY_TEXT, BYTES_OR_TEXT
from damage_formats import CHECKPOINT, EXR, HDF5, JSON, NPY, NPZ, SAFETENSORS, YAML
from exr_bytes import COMPRESSIONS
from forging import PIECE, RENDER, RUN, SCENE
from kinds import Kind, Reader
from samples import MESHES

LOCKS = ("data/renders/.claims", "data/renders/.run", "data/renders/.hashes.json")
SHARDS = ("closed/shards", "closed/.hashes.json")

_PREDICT = "night-eval predict run {file} --out new --device cpu"
PREDICT = Reader(_PREDICT)
USE_RUN = Reader(_PREDICT.format(file="itof.exr"), named=("itof.exr",))
_IMPORT = "night-eval capture import {file} --sidecar {sidecar} --out new.npz"
IMPORT = Reader(
    *(_IMPORT.format(file="{file}", sidecar="camera.toml"), ("new.npz", "new.npz.json"), ("new.npz",))
)
DESCRIBE = Reader(
    *(_IMPORT.format(file="frames.npz", sidecar="{file}"), ("new.npz", "new.npz.json"), ("new.npz",)),
    named=("frames.npz", "dark.npz"),
)
PREDICT_AGAIN = Reader(USE_RUN.command.replace("new", "pred"), writes=("pred",), named=("pred",))
JUDGE = Reader("night-eval run closed --out new --device cpu", ("new", *SHARDS), ("new",))
JUDGE_AGAIN = Reader(JUDGE.command.replace("new", "report"), ("report", *SHARDS), ("report",), ("report",))
TRAIN = Reader(
    "night-train closed --out new --preset training.toml --device cpu",
    ("new", *SHARDS),
    ("new/best.safetensors", "new/history.csv"),  # the log has times in it
    ("shards/000000", "validation loss"),
)
RESUME = Reader(
    "night-train closed --out run --resume --max-epochs 2 --device cpu",
    ("run", *SHARDS),
    ("run/best.safetensors", "run/history.csv"),
)
TRAIN_NOTHING = Reader("night-train made_ply --out new --preset {file}", named=("made_ply",))  # not rendered
STATUS = Reader("night-render status data", LOCKS, ("nothing",))
VERIFY = Reader(
    "night-render verify data --only 000000", (*LOCKS, RENDER), ("nothing",), ("bad: 000000", "000000")
)
LOAD = Reader("load-scene data 000000", named=("scenes/000000",))
TO_ITOF = Reader("night-render convert data --only 000000 --out new --to itof", named=("scene 000000",))
TO_TAL = Reader("night-render convert data --only 000000 --out new --to tal", named=("scene 000000",))
EXPORT = Reader(
    *("night-render export closed --out new.h5", ("new.h5", "closed/.hashes.json"), ("new.h5",)),
    named=("closed", "000000"),
)
MOVIE = Reader("night-render movie data 000000 --out new.gif", ("new.gif",), named=("scene 000000",))
GENERATE = Reader("night-gen scenes new --preset {file} --count 1")
REPAIR = Reader("night-gen scenes made_ply --preset ply.toml", ("made_ply",), named=("made_ply",))
CLUSTER = Reader("night-render data --cluster {file} --dry-run", LOCKS)

MEASUREMENTS = (
    Kind("measurement .exr", "itof.exr", EXR, PREDICT, 0.3, other="other.exr"),
    *(
        Kind(f"measurement, {each}", f"{each}.exr", EXR, PREDICT, 0.05, other="other.exr")
        for each in COMPRESSIONS
    ),
    Kind("measurement .npz", "itof.npz", NPZ, PREDICT, 1, other="other.npz"),
    Kind("measurement .h5", "itof.h5", HDF5, PREDICT, 1, other="other.h5"),
    Kind("capture .npz", "frames.npz", NPZ, IMPORT, 0.3, other="frames.npz"),
    Kind("capture .h5", "frames.h5", HDF5, IMPORT, 0.3, other="frames.h5"),
    Kind("capture .mat", "frames.mat", ANY_BYTES, IMPORT, 1, other="frames.mat"),
    Kind("sidecar", "camera.toml", ANY_TEXT, DESCRIBE, 0.5),
    Kind("earlier prediction", "pred/prediction.json", JSON, PREDICT_AGAIN, 0.2, vouched=True),
)
RUNS = (
    Kind("run.json", f"{RUN}/run.json", JSON, USE_RUN, 0.5, vouched=True),
    Kind("best.safetensors", f"{RUN}/best.safetensors", SAFETENSORS, USE_RUN, 0.5, vouched=True),
    Kind("checkpoint.pt", f"{RUN}/checkpoint.pt", CHECKPOINT, RESUME, 0.5, vouched=True),
    Kind("history.csv", f"{RUN}/history.csv", ANY_TEXT, JUDGE, 0.03),
    Kind("earlier report", "report/metrics.json", JSON, JUDGE_AGAIN, 0.03, vouched=True),
    *(
        Kind(f"forged {file}", f"{RUN}/{file}", damages, reader, 0.5, forge=forge)
        for file, damages, reader, forge in (
            ("run.json", JSON, USE_RUN, forging.config),
            ("best.safetensors", SAFETENSORS, USE_RUN, forging.weights),
            ("checkpoint.pt", CHECKPOINT, RESUME, forging.checkpoint),
        )
    ),
)
DATASETS = (
    *(
        Kind(f"dataset.json, {use}", f"{dataset}/dataset.json", JSON, reader, share)
        for use, dataset, reader, share in (
            ("status", "data", STATUS, 0.3),
            ("verify", "data", VERIFY, 0.2),
            ("convert", "data", TO_ITOF, 0.2),
            ("train", "closed", TRAIN, 0.1),
            ("export", "closed", EXPORT, 0.2),
            ("scenes", "made_ply", REPAIR, 0.1),
        )
    ),
    Kind("rendering.json", "data/renders/rendering.json", JSON, STATUS, 0.2),
    Kind("failure.json", "data/renders/000001/failure.json", JSON, STATUS, 0.1),
    Kind("bad.json", f"{RENDER}/bad.json", JSON, STATUS, 0.1),
    Kind("claim", "data/renders/.claims/000001", JSON, STATUS, 0.1),
    Kind("remembered hashes", "data/renders/.hashes.json", JSON, STATUS, 0.1),
    Kind("render.json", f"{RENDER}/render.json", JSON, VERIFY, 0.3, vouched=True),
)
SCENES = (
    Kind("scene.json", f"{SCENE}/scene.json", JSON, VERIFY, 0.2, vouched=True),
    Kind("scene.xml", f"{SCENE}/scene.xml", ANY_TEXT, VERIFY, 1, vouched=True),
    Kind("mesh of a scene", f"{SCENE}/relay_wall.ply", ANY_BYTES, VERIFY, 0.3, vouched=True),
    *(
        Kind(f"forged {file}", f"{SCENE}/{file}", damages, LOAD, 0.1, forge=forging.scene(file))
        for file, damages in (
            ("scene.json", JSON),
            ("hidden_object_0.ply", BYTES_OR_TEXT),
            ("emitter.pfm", BYTES_OR_TEXT),
        )
    ),
)
RENDERS = (
    Kind("rendered itof.exr", f"{RENDER}/itof.exr", EXR, VERIFY, 0.2, vouched=True),
    Kind("rendered transient.exr", f"{RENDER}/transient.exr", EXR, TO_ITOF, 0.2, vouched=True),
    Kind("itof.exr to train on", "closed/renders/000000/itof.exr", EXR, TRAIN, 0.2),
    Kind("itof.exr to export", "closed/renders/000000/itof.exr", EXR, EXPORT, 0.2),
    Kind("mirrored.exr to export", "closed/renders/000000/mirrored.exr", EXR, EXPORT, 0.2),
    Kind("scene.json to export", "closed/scenes/000000/scene.json", JSON, EXPORT, 0.2, vouched=True),
    *(
        Kind(f"forged {file}, {use}", f"{RENDER}/{file}", EXR, reader, share, forge=forging.render(file))
        for file, use, reader, share in (
            ("itof.exr", "verify", VERIFY, 0.2),
            ("mirrored.exr", "verify", VERIFY, 0.2),
            ("transient.exr", "verify", VERIFY, 0.2),
            ("transient.exr", "to itof", TO_ITOF, 0.3),
            ("transient.exr", "to tal", TO_TAL, 0.3),
            ("transient.exr", "movie", MOVIE, 0.01),
        )
    ),
)
SHARD_FILES = (
    Kind("manifest.json", "closed/shards/manifest.json", JSON, TRAIN, 0.2, vouched=True),
    Kind("reference.npy", "closed/shards/reference.npy", NPY, TRAIN, 0.2, vouched=True),
    Kind("piece.json", f"{PIECE}/piece.json", JSON, TRAIN, 0.2, vouched=True),
    Kind("shard array", f"{PIECE}/phasors.npy", NPY, TRAIN, 0.2, vouched=True),
    Kind("forged shard array", f"{PIECE}/phasors.npy", NPY, TRAIN, 0.3, forge=forging.shard("phasors.npy")),
)
GIVEN = (
    Kind("preset", "preset.toml", ANY_TEXT, GENERATE, 0.5),
    Kind("training preset", "training.toml", ANY_TEXT, TRAIN_NOTHING, 0.5),
    Kind("cluster file", "cluster.yaml", YAML, CLUSTER, 1),
    *(
        Kind(
            f"mesh .{kind}",
            f"mesh.{kind}",
            BYTES_OR_TEXT,
            Reader(f"night-gen scenes made_{kind} --preset {kind}.toml", (f"made_{kind}",)),
            0.6 if kind == "ply" else 0.1,
        )
        for kind in MESHES
    ),
)
_ALL = (*MEASUREMENTS, *RUNS, *DATASETS, *SCENES, *RENDERS, *SHARD_FILES, *GIVEN)
KINDS = {kind.name: kind for kind in _ALL}
