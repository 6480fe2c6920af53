"""From iToF measurements to depth maps: shards, input channels, U-Net, training and evaluation.

Tensors are (N, C, H, W) float32; numpy arrays at the edges keep the axes of `itof` and `scenegen`.
"""

from model.augmentation import AUGMENTATIONS, Augmentation, Warp, augmentation_named
from model.batches import Batch, make_batch
from model.evaluation import EvaluationError, Report, SceneResult, evaluate
from model.feed import MEMORY_PART, Feed, machine_bytes, window_rows
from model.inputs import CHANNELS, InputSpec, fit_input_spec
from model.loss import LOSS_VARIANTS, NightLoss, intersection_over_union
from model.metrics import ImageMetrics, Statistics, Summary, image_metrics, no_object_metrics, summarise
from model.order import rows_by_piece, shuffled_windows, windows_in_order
from model.pointclouds import object_points, write_point_cloud
from model.prediction import Prediction, Predictor, load_run
from model.readout import Readout
from model.renders import RenderedScene, ShardError, read_render
from model.rows import RowBlock, RowLayout
from model.run_folder import RunConfig, RunError, run_settings
from model.settings import DEVICES, DeviceError, TrainSettings, choose_device, settings_from_dict
from model.shards import ShardManifest, Shards, open_shards
from model.training import TrainingError, TrainingResult, train
from model.unet import UNet

__all__ = [
    "AUGMENTATIONS",
    "CHANNELS",
    "DEVICES",
    "LOSS_VARIANTS",
    "MEMORY_PART",
    "Augmentation",
    "Batch",
    "DeviceError",
    "EvaluationError",
    "Feed",
    "ImageMetrics",
    "InputSpec",
    "NightLoss",
    "Prediction",
    "Predictor",
    "Readout",
    "RenderedScene",
    "Report",
    "RowBlock",
    "RowLayout",
    "RunConfig",
    "RunError",
    "SceneResult",
    "ShardError",
    "ShardManifest",
    "Shards",
    "Statistics",
    "Summary",
    "TrainSettings",
    "TrainingError",
    "TrainingResult",
    "UNet",
    "Warp",
    "augmentation_named",
    "choose_device",
    "evaluate",
    "fit_input_spec",
    "image_metrics",
    "intersection_over_union",
    "load_run",
    "machine_bytes",
    "make_batch",
    "no_object_metrics",
    "object_points",
    "open_shards",
    "read_render",
    "rows_by_piece",
    "run_settings",
    "settings_from_dict",
    "shuffled_windows",
    "summarise",
    "train",
    "window_rows",
    "windows_in_order",
    "write_point_cloud",
]
