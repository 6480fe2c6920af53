"""A trained network as a function from measurement to depth map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from itof import join_components
from model.readout import Readout
from model.run_folder import RunConfig, load_weights, read_config
from model.settings import DeviceName, choose_device
from model.unet import UNet

BATCH = 16  # images at a time; QVGA at full width takes about 1 GB


@dataclass(frozen=True)
class Prediction:
    """What the network says of some images.

    Attributes
    ----------
    radial_depth_m : (..., H, W) float32, along the ray, 0 on background.
    mask : (..., H, W) bool, where the hidden object shows.
    phasor : (..., H, W) complex64, of the mirrored scene at the first frequency.
    """

    radial_depth_m: NDArray[np.float32]
    mask: NDArray[np.bool_]
    phasor: NDArray[np.complex64]


@dataclass(frozen=True)
class Predictor:
    """A trained network and all it needs to be used; made by `load_run`."""

    config: RunConfig
    network: UNet
    device: torch.device

    def predict(self, phasor: ArrayLike, reference: ArrayLike | None = None) -> Prediction:
        """Depth map and mask of measurements.

        Parameters
        ----------
        phasor : (H, W, F) or (N, H, W, F) complex, in the unit of the training data.
        reference : (H, W, F) direct return of the bare relay wall; for ``paper`` channels it may be None.

        Raises
        ------
        ValueError : other shapes or frequencies than trained on, or values that are not finite.
        """
        z = np.asarray(phasor)
        if z.ndim not in (3, 4):
            raise ValueError(f"expected phasors of shape (H, W, F) or (N, H, W, F), got {z.shape}")
        if not np.isfinite(z).all():
            raise ValueError("the measurement holds NaN or infinite values")
        images = z if z.ndim == 4 else z[None]
        parts = [
            self._predict_some(self.config.inputs.apply(images[start : start + BATCH], reference))
            for start in range(0, len(images), BATCH)
        ]
        radial_depth_m, mask, predicted = (np.concatenate(x) for x in zip(*parts, strict=True))
        if z.ndim == 3:
            radial_depth_m, mask, predicted = radial_depth_m[0], mask[0], predicted[0]
        return Prediction(radial_depth_m, mask, predicted)

    @torch.no_grad()
    def _predict_some(
        self, channels: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.complex64]]:
        self.network.eval()
        output = self.network(torch.from_numpy(channels).to(self.device))  # (N, 2, H, W)
        return read_output(output, self.config.readout)


def read_output(
    output: Tensor, readout: Readout
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.complex64]]:
    """Radial depth, mask and phasor, each (N, H, W), of network outputs (N, 2, H, W)."""
    output = output.detach()
    components = np.moveaxis(readout.components(output).cpu().numpy(), 1, -1)  # (N, H, W, 2)
    phasor = join_components(components)[..., 0].astype(np.complex64)  # (N, H, W)
    return readout.radial_depth_m(output).cpu().numpy(), readout.mask(output).cpu().numpy() > 0, phasor


def load_run(folder: Path, device: DeviceName = "auto") -> Predictor:
    """A trained network, from its run folder, with the weights of its best epoch.

    Raises
    ------
    RunError : no run, damaged, of another schema or another architecture.
    DeviceError : a device that is not there.
    """
    config = read_config(folder)
    chosen = choose_device(device)
    network = config.network()
    load_weights(folder, network)
    return Predictor(config, network.to(chosen), chosen)
