"""A run folder of half the size, to publish: weights as 16 bit floats, and no checkpoint."""

from __future__ import annotations

from pathlib import Path

from disk import PathLike, whole_folder
from disk.plain_file import MOST_LIST_BYTES, read_plain
from model.run_folder.history import HISTORY_FILE, read_history
from model.run_folder.run_config import CONFIG_FILE, RunError, read_config
from model.run_folder.shipped import run_folder
from model.run_folder.weights import save_weights, trained_network


def compact(run: PathLike, out: PathLike) -> Path:
    """Write the folder `out` with what a prediction, an evaluation and `night-train --from` need of a run.

    16 bit floats round weights by up to 5e-4 of their size; the run keeps its id. It has no
    checkpoint, so `--resume` refuses it.

    Raises
    ------
    RunError : the run or its history is damaged or without weights, a weight is too large
        for 16 bits, or `out` exists.
    """
    folder, out = run_folder(run), Path(out).resolve()
    if out.exists():
        raise RunError(f"{out} exists already: choose another folder")
    config = read_config(folder)
    network, _ = trained_network(folder, config)
    weights = network.state_dict()
    large = next((name for name, each in weights.items() if not bool(each.half().isfinite().all())), None)
    if large is not None:
        raise RunError(f"{folder} has weights that are too large for 16 bits ({large}): publish it whole")
    names = [CONFIG_FILE, HISTORY_FILE] if read_history(folder) else [CONFIG_FILE]  # both were checked
    files = {name: read_plain(folder / name, MOST_LIST_BYTES) for name in names}
    with whole_folder(out) as partial:
        for name, content in files.items():
            (partial / name).write_bytes(content)
        save_weights(partial, weights, config.run_id, half=True)
    return out
