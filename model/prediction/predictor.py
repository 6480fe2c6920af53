"""A trained network as a function from measurements to depth maps."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from disk import NightError, PathLike
from disk.frequency_text import megahertz
from disk.quantities import MAX_FOV_DEG, MIN_FOV_DEG
from disk.told import Told
from itof import DepthMap, amplitude
from itof.wall.empty_corner import CapturedPlane, captured_wall, find_wall
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallPlaceError, WallView
from model.device import choose_device, plain_memory_errors
from model.network.mask_and_depth import MaskAndDepth
from model.network.readout import Readout
from model.network.unet import UNet, average_with_flip
from model.prediction.expected_error import expected_mae_m
from model.prediction.explained_light import ExplainedLight, explained_light, hidden_light
from model.run_folder.run_config import RunConfig, RunError, read_config
from model.run_folder.shipped import run_folder
from model.run_folder.weights import trained_network
from model.settings.run import DeviceName

NEEDS_CAPTURE = "was trained for a capture of the empty corner: give one as reference"
BATCH = 16  # images at a time; 320 x 240 pixels at full network width take about 1 GB


class InputError(NightError):
    """Measurements that a network cannot be used on."""


@dataclass(frozen=True, repr=False)
class Predictor(Told):
    """A trained network with its configuration, on a device; made by `load`.

    Attributes
    ----------
    weights_sha256 : of its ``best.safetensors``.
    """

    config: RunConfig
    network: UNet
    device: torch.device
    weights_sha256: str

    def __repr__(self) -> str:
        return "\n".join(self.sentences)

    @property
    def sentences(self) -> tuple[str, str]:
        """What it is for."""
        config, inputs = self.config, self.config.inputs
        views = " to ".join(dict.fromkeys(f"{view_deg:.3g}" for view_deg in config.trained_views_deg))
        seen = f"{config.image_width} x {config.image_height} pixels, {megahertz(*inputs.frequencies_hz)}"
        weights = f"{sum(each.numel() for each in self.network.parameters()):,} weights on {self.device}"
        channels = f"channels {inputs.channels}, target {config.readout.target}"
        return f"Predictor for {seen}, {views} degrees", f"{channels}, {weights}"

    @cached_property
    def reference(self) -> NDArray[np.complex64]:
        """(H, W, F) direct return of the run's relay wall, with the precision of the shards."""
        config = self.config
        size = (config.image_width, config.image_height)
        return config.geometry.direct_phasors(*size, config.inputs.frequencies_hz).astype(np.complex64)

    @cached_property
    def wall(self) -> ExpectedWall:
        """The relay wall of the run, where its camera should see it.

        Raises
        ------
        RunError : the camera of the run does not see a wall.
        """
        try:
            return self.config.geometry.expected_wall(self.reference, self.config.inputs.frequencies_hz)
        except WallPlaceError as error:
            raise RunError(f"the geometry of the run cannot be: {error}") from None

    def at(self, corner: WallView) -> Predictor:
        """The same network at another corner, whose wall is expected where `corner` says."""
        return replace(self, config=replace(self.config, geometry=corner))

    def for_size(self, width: int, height: int) -> Predictor:
        """The same network for images of so many pixels, if it `reads` them; else this one."""
        if not self.config.reads(width, height):
            return self
        return replace(self, config=replace(self.config, image_width=width, image_height=height))

    def expected_mae_m(self, prediction: DepthMap) -> float | None:
        """MAE over all pixels that the network expects of its depth map (H, W), metres.

        None for a network that predicts no probabilities.
        """
        return expected_mae_m(prediction) if self.config.settings.predicts_probability else None

    def predict(
        self,
        phasors: ArrayLike,
        reference: ArrayLike | None = None,
        *,
        rescale: bool = False,
        fields_of_view_deg: Sequence[float] = (),
    ) -> DepthMap:
        """Depth maps of measurements: the mirror image of the hidden object in the relay wall.

        Parameters
        ----------
        phasors : (H, W, F) or (N, H, W, F) complex at the frequencies `config.inputs.frequencies_hz`, in this
            order. H and W are those of the training, or of `for_size`.
        reference : (H, W, F) complex measurement of the empty corner, up to a real factor, which may tell
            where the wall is (`itof.wall.empty_corner.captured_wall`); None for the computed return. A run
            with the setting ``reference = "capture"`` needs it.
        rescale : multiply each image so that its mean amplitude at the first frequency is the mean of the
            training scenes. Use it if the phasors have another unit than the training scenes.
        fields_of_view_deg : N full horizontal fields of view, if the images have different ones; by default
            all have that of the camera of the run (`at` changes it). Not with a reference.

        Returns
        -------
        Depth map with (H, W) or (N, H, W) radial depth float32 in metres, mask bool and phasor complex64 at
        `config.output_frequency_hz`, and the expected error of the depth float32 in metres if the run has
        the setting ``uncertainty``.

        Raises
        ------
        InputError : the run needs a measured reference, shape or number of frequencies differ from the
            training, a value is not finite, an image without light is to be rescaled, there is another number
            of fields of view, or one that no camera has.
        RunError : the output of the network is not finite.
        """
        z, views = np.asarray(phasors), [float(fov_deg) for fov_deg in fields_of_view_deg]
        self._refuse_other_images(z)
        images = z if z.ndim == 4 else z[None]
        if views:
            self._refuse_fields_of_view(views, len(images), reference)
        wall = None if views else self.wall_of(reference)
        if rescale:
            images = images * self._gain(images)
        parts = [
            self._predict_some(
                self._channels_of_views(images[some], views[some])
                if views
                else self._channels(images[some], wall)
            )
            for some in (slice(start, start + BATCH) for start in range(0, len(images), BATCH))
        ]
        predicted = _joined(parts)
        return predicted[0] if z.ndim == 3 else predicted

    @property
    def _image_shape(self) -> tuple[int, int, int]:
        config = self.config
        return config.image_height, config.image_width, len(config.inputs.frequencies_hz)

    def _refuse_other_images(self, z: NDArray[np.generic]) -> None:
        if z.ndim not in (3, 4):
            raise InputError(f"expected phasors of shape (H, W, F) or (N, H, W, F), got {z.shape}")
        if z.shape[-3:] != self._image_shape or not z.size:
            raise InputError(
                f"expected phasors of shape {self._image_shape} (H, W, F), or several such images, got "
                f"{z.shape}" + (" (for_size reads other sizes)" if self.config.inputs.shows_rays else "")
            )
        _refuse_not_phasors(z, "the measurement")

    def explained_light(
        self,
        phasors: ArrayLike,
        predictions: DepthMap | Sequence[DepthMap],
        reference: ArrayLike | None = None,
        *,
        fields_of_view_deg: Sequence[float] = (),
        thorough: bool = False,
    ) -> tuple[ExplainedLight | None, ...]:
        """How much of the hidden light of images (N, H, W, F) their predictions explain.

        None for a network without residual channels. `thorough` is that of `explained_light`, the other
        arguments are those of `predict`, whose errors it has.
        """
        images = np.asarray(phasors)
        views = [self.at(self.config.geometry.with_fov(fov_deg)) for fov_deg in fields_of_view_deg]
        walls = [one.wall_of(None) for one in views] or [self.wall_of(reference)] * len(images)
        return tuple(
            None
            if wall is None
            else explained_light(self.config.inputs, image, wall, predictions[place], thorough=thorough)
            for place, (image, wall) in enumerate(zip(images, walls, strict=True))
        )

    def hidden_light(
        self, phasor: ArrayLike, reference: ArrayLike | None = None
    ) -> NDArray[np.float64] | None:
        """(H, W) light of an image (H, W, F) that is not the wall's, relative to the mean direct return.

        None for a network without residual channels. The errors are those of `predict`.
        """
        wall = self.wall_of(reference)
        return None if wall is None else hidden_light(self.config.inputs, phasor, wall)

    def wall_of(self, reference: ArrayLike | None) -> ExpectedWall | None:
        """The wall with the reference to use; None if the channels need none, so that it is not computed."""
        inputs = self.config.inputs
        if reference is None:
            if inputs.needs_capture:
                raise InputError(f"the run {NEEDS_CAPTURE}")
            return self.wall if inputs.uses_residual else None
        known = np.asarray(reference)
        if known.shape != self._image_shape:
            raise InputError(f"expected a reference of shape {self._image_shape}, got {known.shape}")
        _refuse_not_phasors(known, "the reference")
        if not inputs.uses_residual:
            return None
        return captured_wall(known, self.wall) if self._moves_wall(known) else self.wall.captured(known)

    def found_wall(self, reference: ArrayLike) -> CapturedPlane | None:
        """Where a capture (H, W, F) of the empty corner shows the wall; None if that does not matter.

        It matters to channels that calibrate themselves.
        """
        known = np.asarray(reference)
        return find_wall([known], self.wall) if self._moves_wall(known) else None

    def _moves_wall(self, reference: NDArray[np.generic]) -> bool:
        """Whether the place of the wall is taken from a reference, which may also be the computed return."""
        return self.config.inputs.self_calibrates and not np.array_equal(reference, self.reference)

    @staticmethod
    def _refuse_fields_of_view(
        fields_of_view_deg: Sequence[float], count: int, reference: ArrayLike | None
    ) -> None:
        if reference is not None:
            raise InputError("a reference is that of one camera: give it without fields_of_view_deg")
        if len(fields_of_view_deg) != count:
            raise InputError(
                f"{count} images have {len(fields_of_view_deg)} fields_of_view_deg: give one each"
            )
        for fov_deg in fields_of_view_deg:
            if not MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG:
                raise InputError(
                    f"fields_of_view_deg are between {MIN_FOV_DEG:g} and {MAX_FOV_DEG:g} degrees, got "
                    f"{fov_deg:g}"
                )

    def _channels_of_views(
        self, images: NDArray[np.generic], fields_of_view_deg: Sequence[float]
    ) -> NDArray[np.float32]:
        """Channels of images with a field of view each."""
        seen = [self.at(self.config.geometry.with_fov(fov_deg)) for fov_deg in fields_of_view_deg]
        pairs = zip(seen, images, strict=True)
        return np.concatenate([one._channels(image[None], one.wall_of(None)) for one, image in pairs])

    def _channels(self, images: NDArray[np.generic], wall: ExpectedWall | None) -> NDArray[np.float32]:
        with np.errstate(over="ignore", invalid="ignore"):  # the check below finds overflows
            inputs = self.config.inputs
            known = None if wall is None else inputs.reference_of_image(images, wall)
            channels = inputs.apply(images, known, is_weighted=True)  # (N, C, H, W)
        if not np.isfinite(channels).all():
            raise InputError(
                "the measurement holds values too large for the network's float32 channels: rescale it, or "
                "set pixels that received almost no light to 0"
            )
        return channels

    def _gain(self, images: NDArray[np.generic]) -> NDArray[np.float64]:
        """(N, 1, 1, 1) factors that give (N, H, W, F) phasors the mean amplitude of the training scenes."""
        mean = amplitude(images[..., 0]).mean(axis=(1, 2), dtype=np.float64)  # (N,)
        if not (mean > 0).all():
            dark = int(np.flatnonzero(~(mean > 0))[0])
            raise InputError(
                f"image {dark} of {len(images)} holds no light at the first frequency: it cannot be rescaled"
            )
        gain: NDArray[np.float64] = self.config.inputs.mean_amplitude / mean
        return gain[:, None, None, None]

    @plain_memory_errors()
    @torch.no_grad()
    def _predict_some(self, channels: NDArray[np.float32]) -> DepthMap:
        self.network.eval()
        images = torch.from_numpy(channels).to(self.device)
        output = self.network(images)  # (N, C, H, W)
        if self.config.settings.run.average_flip:
            output = average_with_flip(self.network, images, output)
        if not bool(output.isfinite().all()):
            raise RunError(
                "the network answers with NaN or infinite values: its weights are damaged, or the "
                "measurement is far from those that it was trained on"
            )
        return read_output(output, self.config.readout)


def _refuse_not_phasors(z: NDArray[np.generic], what: str) -> None:
    if not np.iscomplexobj(z):
        raise InputError(f"{what} must be complex phasors, got {z.dtype}")
    if not np.isfinite(z).all():
        raise InputError(f"{what} holds NaN or infinite values")


def read_output(output: Tensor, readout: Readout) -> DepthMap:
    """Depth maps (N, H, W) of network outputs (N, C, H, W)."""
    output = output.detach()
    phasor = torch.complex(*readout.components(output).unbind(1))  # (N, H, W)
    error_m = readout.depth_error_m(output) if isinstance(readout, MaskAndDepth) else None
    return DepthMap(
        readout.radial_depth_m(output).cpu().numpy(),
        readout.mask(output).cpu().numpy() > 0,
        phasor.cpu().numpy(),
        readout.frequency_hz,
        None if error_m is None else error_m.cpu().numpy(),
    )


def _joined(parts: Sequence[DepthMap]) -> DepthMap:
    """Depth maps (N, H, W) as one."""
    errors_m = [part.depth_error_m for part in parts if part.depth_error_m is not None]
    return DepthMap(
        np.concatenate([part.radial_depth_m for part in parts]),
        np.concatenate([part.mask for part in parts]),
        np.concatenate([part.phasor for part in parts]),
        parts[0].frequency_hz,
        np.concatenate(errors_m) if errors_m else None,
    )


def load(run: PathLike, device: DeviceName = "auto") -> Predictor:
    """Load a trained network, with the weights of its best epoch.

    Parameters
    ----------
    run : run folder, or the name of a network that comes with the program (`shipped_runs`).

    Raises
    ------
    RunError : the folder is missing or not a run, or its files are damaged or do not fit together.
    DeviceError : the device does not exist.
    """
    folder = run_folder(run)
    config = read_config(folder)
    chosen = choose_device(device)
    with plain_memory_errors():
        network, content = trained_network(folder, config)
        return Predictor(config, network.to(chosen), chosen, hashlib.sha256(content).hexdigest())
