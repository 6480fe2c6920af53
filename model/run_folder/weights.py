"""``best.safetensors`` of a run folder: the weights of the best epoch.

Its metadata has the one entry ``night``, a `label_text`: the id of the run and the file's own checksum. (With
several entries, the library would write them in random order.)
"""

from __future__ import annotations

from collections.abc import Mapping
from errno import EFBIG
from pathlib import Path
from typing import Any, Final

import torch
from safetensors.torch import load, save
from torch import Tensor

from disk import whole_file
from disk.checksums import label_text, labelled, read_label
from disk.plain_file import read_plain
from model.network.unet import UNet, least_weights
from model.run_folder.run_config import RunConfig, RunError

WEIGHTS_FILE: Final = "best.safetensors"
_METADATA: Final = "night"
_MOST_HEADER: Final = 2**20  # bytes; the header of the paper's network has 8 kB
_AGAIN: Final = "write it again from the checkpoint with night-train --resume, or train again"


def save_weights(folder: Path, weights: Mapping[str, Tensor], run_id: str, *, half: bool = False) -> None:
    """Write ``best.safetensors`` of the run `run_id`, with `half` as 16 bit floats; `OSError` on failure."""
    plain = {name: tensor.cpu().contiguous() for name, tensor in weights.items()}
    if half:
        plain = {name: tensor.half() for name, tensor in plain.items()}
    content = labelled(save(plain, {_METADATA: label_text(run_id)}))
    with whole_file(folder / WEIGHTS_FILE) as partial:
        partial.write_bytes(content)


def trained_network(folder: Path, config: RunConfig) -> tuple[UNet, bytes]:
    """The network of the run that `config` describes, with the weights of ``best.safetensors``.

    Weights that are 16 bit floats, as in a compact run (`model.run_folder.compact`), become 32 bit floats.

    Returns
    -------
    The network, on the CPU, and the content of the file.

    Raises
    ------
    RunError : the file is missing or damaged, or its weights belong to another run or architecture, or they
        are not finite.
    """
    file = folder / WEIGHTS_FILE
    if not file.is_file():
        raise RunError(
            f"{folder} has no best.safetensors: no epoch was finished; resume it with night-train --resume"
        )
    least, network = least_bytes(config), None
    try:
        most = file.stat().st_size
        if most >= least:  # or a network that run.json alone calls large would take all memory
            network = config.network()
            most = sum(tensor.nbytes for tensor in network.state_dict().values()) + _MOST_HEADER
        content = read_plain(file, most)
    except OSError as error:
        if error.errno == EFBIG:
            raise RunError(
                f"{file} holds weights of another architecture than run.json describes: {error.strerror}"
            ) from None
        raise RunError(f"{file} cannot be read: {error.strerror or error}") from None
    refuse_other_label(content, file, config, _AGAIN)
    try:
        weights = load(content)
    except Exception as error:  # whatever a library says of a file that somebody else made
        raise RunError(f"{file} is no safetensors file ({error}): {_AGAIN}") from None
    if network is None:
        raise RunError(
            f"{file} holds weights of another architecture than run.json describes: it has {len(content)} "
            f"bytes, at least {least} are needed"
        )
    whole = {name: each.float() if each.dtype == torch.float16 else each for name, each in weights.items()}
    fill(network, whole, file)
    return network, content


def least_bytes(config: RunConfig) -> int:
    """What the weights of a run take at least, as 16 bit floats."""
    sizes = config.settings.network
    return 2 * least_weights(config.inputs.channel_count, sizes.width, sizes.levels, sizes.block)


def refuse_other_label(content: bytes, file: Path, config: RunConfig, again: str) -> None:
    """Refuse a file whose checksum is wrong, or that belongs to another run than `config`.

    Parameters
    ----------
    again : what to do, for the message.
    """
    label = read_label(content)
    if label is None or not label.is_right:
        raise RunError(f"{file} is damaged ({'no' if label is None else 'wrong'} checksum): {again}")
    if config.run_id != label.run_id:
        raise RunError(f"{file} belongs to another run than run.json beside it: {again}")


def fill(network: UNet, weights: Mapping[str, Tensor], file: Path) -> None:
    """Load `weights` into `network`; `RunError` if they are of another architecture or not finite."""
    problem = misfit(weights, network.state_dict())
    if problem:
        raise RunError(f"{file} holds weights of another architecture than run.json describes: {problem}")
    bad = next((name for name, tensor in weights.items() if not bool(tensor.isfinite().all())), None)
    if bad is not None:
        raise RunError(f"{file} holds weights that are NaN or infinite ({bad}): train again")
    network.load_state_dict(dict(weights))


def misfit(found: Any, expected: Mapping[str, Tensor]) -> str | None:
    """The first tensor that differs from the expected ones in name, shape or number type; None if none does.

    Parameters
    ----------
    found : tensors by name; contents of a file, and therefore of any type.
    """
    if not isinstance(found, Mapping):
        return f"{type(found).__name__} instead of tensors by name"
    given = {name: _kind(tensor) for name, tensor in found.items()}
    wanted = {name: _kind(tensor) for name, tensor in expected.items()}
    if given == wanted:
        return None
    name = min((name for name in {*given, *wanted} if given.get(name) != wanted.get(name)), key=str)
    return f"{name} is {given.get(name, 'missing')}, expected {wanted.get(name, 'no such weight')}"


def _kind(tensor: Any) -> str:
    """Shape and number type as text."""
    if not isinstance(tensor, Tensor) or tensor.layout != torch.strided or tensor.is_meta:
        return f"no array ({type(tensor).__name__})"
    return f"{tuple(tensor.shape)} {str(tensor.dtype).removeprefix('torch.')}"
