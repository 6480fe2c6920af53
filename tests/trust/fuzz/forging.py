"""Records that match a damaged file, as a stranger would write them who changes both.

No hash refuses such a file: only careful readers stand between it and the program. Each function takes the
folder of the samples, where the file is not damaged yet, and the damaged bytes; it returns files by name.
"""

import json

from disk import sha256_of
from disk.checksums import labelled, read_label, with_checksum
from scenegen.scene_folder import digest_of

RENDER = "data/renders/000000"
SCENE = "data/scenes/000000"
PIECE = "closed/shards/000000"
RUN = "run"
_MARK = '"sha256": "'  # before the checksum in run.json


def render(file):
    """``render.json`` with the size and hash of a render."""

    def forge(work, data):
        (work / RENDER / file).write_bytes(data)
        record = json.loads((work / RENDER / "render.json").read_text())
        record["files"][file] = {"bytes": len(data), "sha256": sha256_of(work / RENDER / file)}
        return {f"{RENDER}/{file}": data, f"{RENDER}/render.json": _json(record)}

    return forge


def scene(file):
    """``dataset.json`` with the digest of a scene folder."""

    def forge(work, data):
        files = {path.name: path.read_bytes() for path in (work / SCENE).iterdir()}
        index = json.loads((work / "data" / "dataset.json").read_text())
        index["scenes"][0]["sha256"] = digest_of(files | {file: data})
        return {f"{SCENE}/{file}": data, "data/dataset.json": _json(index)}

    return forge


def shard(file):
    """``piece.json`` and ``manifest.json`` with the hash of an array."""

    def forge(work, data):
        (work / PIECE / file).write_bytes(data)
        record = json.loads((work / PIECE / "piece.json").read_text())
        record["files"][file] = sha256_of(work / PIECE / file)
        manifest = json.loads((work / "closed/shards/manifest.json").read_text())
        manifest["pieces"][0] = record
        return {
            f"{PIECE}/{file}": data,
            f"{PIECE}/piece.json": _json(record),
            "closed/shards/manifest.json": _json(manifest),
        }

    return forge


def config(work, data):
    """``run.json`` with its own checksum, where the damage has left room for it."""
    return {f"{RUN}/run.json": with_checksum(data, _MARK) if _MARK.encode() in data else data}


def weights(work, data):
    """``best.safetensors`` with its own checksum, where the damage has left room for it."""
    return {f"{RUN}/best.safetensors": labelled(data) if read_label(data) else data}


def checkpoint(work, data):
    """``checkpoint.pt`` with its own checksum, where the damage has left room for it."""
    return {f"{RUN}/checkpoint.pt": labelled(data) if read_label(data) else data}


def _json(content):
    return json.dumps(content, indent=2).encode() + b"\n"
