"""A trained network as an ONNX file, for programs without PyTorch."""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import TypeAdapter

from model.network.unet import UNet
from model.prediction.predictor import load
from model.run_folder import RunConfig
from scenegen import NightError, whole_file

INPUT: Final = "channels"
OUTPUT: Final = "components"
METADATA: Final = "night.run"  # key under which the run's config stands as JSON
NEEDED: Final = ("onnx", "onnxruntime", "onnxscript")
# Images in a batch, and how strong its channels are. A trained network may answer one kind of image with
# dead units throughout, which would compare nothing.
CHECKED: Final = ((1, 1.0), (3, 1.0), (1, 10.0), (1, 100.0))
COARSE: Final = 8  # pixels from one random value to the next: hidden light is smooth, white noise is no light
# The same sums in another order differ by as much as either differs from the exact ones; ten times that
# leaves room for the extremes among all pixels.
ALLOWANCE: Final = 10.0


class ExportError(NightError):
    """A file name that is no ONNX file's, a package that is missing, or a network that came out different."""


@dataclass(frozen=True)
class OnnxCheck:
    """How well ONNX Runtime reproduces the network, on smooth random channels; of the worst batch.

    Attributes
    ----------
    largest_difference : between outputs, whose truth has amplitude 0 or 1.
    tolerance : the difference from which on the export is refused.
    largest_output : magnitude that outputs of that batch reach.
    """

    largest_difference: float
    tolerance: float
    largest_output: float

    def sentence(self, out: Path) -> str:
        """The outcome for people to read; `out` is the file."""
        return (
            f"{out}: differs from PyTorch by at most {self.largest_difference:.2g} where outputs reach "
            f"{self.largest_output:.2g} ({self.tolerance:.2g} is rounding)"
        )


def export_onnx(run: Path, out: Path, *, seed: int = 0) -> OnnxCheck:
    """Write the network of `run` as the ONNX file `out`, whole or not at all; an older one is replaced.

    Input ``channels`` (N, C, H, W) float32, as `InputSpec.apply` makes them; output ``components``
    (N, 2, H, W) float32, Re and Im of the mirrored scene. N is free, H and W are those of the training. The
    metadata's ``night.run`` is the run's ``run.json``: channels, their constants, camera and wall.

    Before it gets its name the file is run by ONNX Runtime on smooth random channels, weak and strong, and
    compared with PyTorch.

    Raises
    ------
    ExportError : an `out` that does not end in .onnx or is a folder; packages that are missing; outputs that
        differ by more than rounding.
    RunError : an unusable run.
    """
    if out.suffix != ".onnx" or out.is_dir():
        raise ExportError(f"{out} is no name for an ONNX file: give a file that ends in .onnx")
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise ExportError(
            f"ONNX export needs {', '.join(missing)}: install it with  pip install 'night-nlos[onnx]'"
        )
    predictor = load(run, "cpu")
    network, config = predictor.network.eval(), predictor.config
    model = _onnx_model(network, config)
    with whole_file(out) as partial:
        partial.write_bytes(model.SerializeToString())
        check = _compare(partial, network, config, seed)
        if not check.largest_difference <= check.tolerance:
            raise ExportError(
                "ONNX Runtime computes something else than PyTorch: outputs differ by "
                f"{check.largest_difference:.2g}, rounding explains {check.tolerance:.2g}; nothing is written"
            )
    return check


def _onnx_model(network: UNet, config: RunConfig) -> Any:
    """The network as an `onnx.ModelProto` with the run's config in its metadata."""
    import onnx

    shape = (2, config.inputs.channel_count, config.image_height, config.image_width)  # 2: N stays free
    with _quiet():
        program = torch.onnx.export(
            network,
            (torch.zeros(shape),),
            input_names=[INPUT],
            output_names=[OUTPUT],
            dynamic_shapes=({0: torch.export.Dim("N", min=1)},),
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ExportError("PyTorch made no ONNX model of this network")
    model = program.model_proto
    for node in model.graph.node:
        del node.metadata_props[:]  # where each line of this program lies on this machine
    entry = model.metadata_props.add()
    entry.key, entry.value = METADATA, TypeAdapter(RunConfig).dump_json(config).decode()
    onnx.checker.check_model(model)
    return model


def _compare(file: Path, network: UNet, config: RunConfig, seed: int) -> OnnxCheck:
    """Differences over all checked batch sizes; the tolerance is PyTorch's own error against float64."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors alone
    session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    exact = copy.deepcopy(network).double()
    generator = torch.Generator().manual_seed(seed)
    checks = []
    for count, strength in CHECKED:
        channels = strength * _smooth_channels(count, config, generator)
        ours = _run(network, channels)
        truth = _run(exact, channels.double())
        theirs = np.asarray(session.run([OUTPUT], {INPUT: channels.numpy()})[0])
        largest = float(np.abs(truth).max())
        one_rounding = float(np.finfo(np.float32).eps) * max(largest, 1.0)  # the truth has amplitude 1
        rounding = max(float(np.abs(ours - truth).max()), one_rounding)
        checks.append(OnnxCheck(float(np.abs(theirs - ours).max()), ALLOWANCE * rounding, largest))
    return max(checks, key=lambda check: check.largest_difference / check.tolerance)


def _smooth_channels(count: int, config: RunConfig, generator: torch.Generator) -> torch.Tensor:
    """(count, C, H, W) random fields that change over COARSE pixels."""
    size = (config.image_height, config.image_width)
    coarse = [2 + pixels // COARSE for pixels in size]  # a value at either border
    values = torch.randn(count, config.inputs.channel_count, *coarse, generator=generator)
    return torch.nn.functional.interpolate(values, size=size, mode="bilinear", align_corners=True)


@torch.no_grad()
def _run(network: UNet, channels: torch.Tensor) -> NDArray[np.floating[Any]]:
    output: NDArray[np.floating[Any]] = network(channels).numpy()
    return output


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the exporter's logs, and what PyTorch deprecates of its own, off the terminal."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            for category in (FutureWarning, DeprecationWarning):
                warnings.simplefilter("ignore", category)
            yield
    finally:
        logging.disable(before)
