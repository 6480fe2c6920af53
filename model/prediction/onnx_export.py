"""Export of a trained network as an ONNX file, for programs without PyTorch."""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import TypeAdapter

from disk import NightError, PathLike, whole_file
from disk.extras import need
from itof import pixel_rays
from itof.wall.turned_axes import turned_rays
from model.device import plain_memory_errors
from model.network.channels import RAYS
from model.network.unet import UNet
from model.prediction.predictor import load
from model.run_folder.run_config import RunConfig
from model.settings.train_settings import TrainSettings

INPUT: Final = "channels"
# Names of the output, by target, and whether it has an uncertainty.
OUTPUTS: Final = {
    ("components", False): "components",
    ("depth", False): "radial_depth_m",
    ("mask+depth", False): "logit_and_depth",
    ("mask+depth", True): "logit_depth_and_log_error",
}
METADATA: Final = "night.run"  # key of the metadata; its value is ``run.json``
# Batches of the check: number of images, amplitude of their channels. There are several amplitudes because
# the units of a trained network may all be inactive at one of them; a comparison of zeros proves nothing.
CHECKED: Final = ((1, 1.0), (3, 1.0), (1, 10.0), (1, 100.0))
COARSE: Final = 8  # pixels between random values; hidden light varies smoothly, so white noise is no test
# Two orders of the same summation differ by about their rounding errors. The factor 10 allows for the largest
# difference among all pixels.
ALLOWANCE: Final = 10.0


class ExportError(NightError):
    """Export failed: the file name is wrong, or the exported network differs."""


@dataclass(frozen=True)
class OnnxCheck:
    """Comparison of ONNX Runtime with PyTorch on smooth random channels; the worst of several batches.

    Attributes
    ----------
    largest_difference : largest difference of the outputs; the ground truth has amplitude 0 or 1.
    tolerance : largest difference that rounding explains.
    largest_output : largest magnitude of the outputs.
    """

    largest_difference: float
    tolerance: float
    largest_output: float

    def sentence(self, out: PathLike) -> str:
        """The outcome as text; `out` is the file."""
        return (
            f"{out}: differs from PyTorch by at most {self.largest_difference:.2g}, with outputs up to "
            f"{self.largest_output:.2g} (rounding explains up to {self.tolerance:.2g})"
        )


def export_onnx(run: PathLike, out: PathLike) -> OnnxCheck:
    """Write the network of `run` as the ONNX file `out`, whole or not at all.

    The input ``channels`` (N, C, H, W) float32 are those of `InputSpec.apply`. The output ``components``
    (N, 2, H, W) float32 is Re and Im of the mirrored scene; of a network that predicts depth it is
    ``radial_depth_m`` (N, 1, H, W), metres, before any threshold, and of one that predicts mask and depth
    ``logit_and_depth`` (N, 2, H, W), whose depth is standardised by ``object_depth_m``; with uncertainty
    ``logit_depth_and_log_error`` (N, 3, H, W), with the logarithm of the expected error of that depth. N is
    free, H and W are those of the training. The metadata ``night.run`` contains ``run.json``: channels, their
    constants, camera and wall.

    Before the file gets its name, ONNX Runtime computes outputs of smooth random channels with it, and they
    are compared with those of PyTorch.

    Parameters
    ----------
    run : run folder of the trained network.

    Raises
    ------
    ExportError : `out` does not end in .onnx or is a folder; the outputs differ by more than rounding, or are
        not finite.
    MissingPackageError : the extra ``onnx`` is not installed.
    RunError : the run cannot be used.
    """
    out = Path(out)
    if out.suffix != ".onnx" or out.is_dir():
        raise ExportError(f"{out} cannot be an ONNX file: give a file that ends in .onnx")
    need("onnx", ("onnx", "onnxruntime", "onnxscript"), "night-eval export")
    predictor = load(run, "cpu")
    network, config = predictor.network.eval(), predictor.config
    with plain_memory_errors():
        model = _onnx_model(network, config)
    with whole_file(out) as partial:
        partial.write_bytes(model.SerializeToString())
        check = _compare(partial, network, config)
        if not check.largest_difference <= check.tolerance:
            raise ExportError(
                "ONNX Runtime computes something else than PyTorch: outputs differ by "
                f"{check.largest_difference:.2g}, rounding explains {check.tolerance:.2g}; nothing is written"
            )
    return check


def output_name(settings: TrainSettings) -> str:
    """Name of the output of a network with these settings."""
    return OUTPUTS[settings.target.kind, settings.predicts_uncertainty]


def _onnx_model(network: UNet, config: RunConfig) -> Any:
    """The network as an `onnx.ModelProto` with the run's configuration in its metadata."""
    import onnx

    # The exporter would treat N = 1 as a fixed size, so the example has two images.
    example = _smooth_channels(2, config, torch.Generator())
    with _quiet():
        program = torch.onnx.export(
            network,
            (example,),
            input_names=[INPUT],
            output_names=[output_name(config.settings)],
            dynamic_shapes=({0: torch.export.Dim("N", min=1)},),
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ExportError("PyTorch made no ONNX model of this network")
    model = program.model_proto
    for node in model.graph.node:
        del node.metadata_props[:]  # paths and source lines of this machine
    entry = model.metadata_props.add()
    entry.key, entry.value = METADATA, TypeAdapter(RunConfig).dump_json(config).decode()
    onnx.checker.check_model(model)
    return model


def _compare(file: Path, network: UNet, config: RunConfig) -> OnnxCheck:
    """The worst check of all batches. The tolerance follows from PyTorch's own error against float64."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors only
    session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    exact = copy.deepcopy(network).double()
    generator = torch.Generator().manual_seed(0)
    checks = []
    for count, strength in CHECKED:
        channels = strength * _smooth_channels(count, config, generator)
        ours = _run(network, channels)
        truth = _run(exact, channels.double())
        theirs = np.asarray(session.run([output_name(config.settings)], {INPUT: channels.numpy()})[0])
        if not all(np.isfinite(output).all() for output in (ours, truth, theirs)):
            raise ExportError(
                "the network answers with NaN or infinite values to random channels: its weights are of no "
                "use, train again"
            )
        largest = float(np.abs(truth).max())
        one_rounding = float(np.finfo(np.float32).eps) * max(largest, 1.0)  # the ground truth has amplitude 1
        rounding = max(float(np.abs(ours - truth).max()), one_rounding)
        checks.append(OnnxCheck(float(np.abs(theirs - ours).max()), ALLOWANCE * rounding, largest))
    return max(checks, key=lambda check: check.largest_difference / check.tolerance)


def _smooth_channels(count: int, config: RunConfig, generator: torch.Generator) -> torch.Tensor:
    """(count, C, H, W) random fields, interpolated between values COARSE pixels apart; rays where needed."""
    size = (config.image_height, config.image_width)
    own = config.inputs.channel_count - RAYS * config.inputs.shows_rays
    coarse = [2 + pixels // COARSE for pixels in size]  # with a value at both borders
    values = torch.randn(count, own, *coarse, generator=generator)
    fields = torch.nn.functional.interpolate(values, size=size, mode="bilinear", align_corners=True)
    if not config.inputs.shows_rays:
        return fields
    view = config.geometry
    rays = np.moveaxis(pixel_rays(*size[::-1], view.horizontal_fov_deg), -1, 0)
    seen = torch.from_numpy(turned_rays(view.plane_per_m, rays)).to(fields.dtype)
    return torch.cat([fields, seen.expand(count, -1, -1, -1)], dim=1)


@torch.no_grad()
def _run(network: UNet, channels: torch.Tensor) -> NDArray[np.floating[Any]]:
    output: NDArray[np.floating[Any]] = network(channels).numpy()
    return output


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the exporter's log and the deprecation warnings about PyTorch's own code."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            for category in (FutureWarning, DeprecationWarning):
                warnings.simplefilter("ignore", category)
            yield
    finally:
        logging.disable(before)
