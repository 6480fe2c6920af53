"""From iToF measurements to depth maps: shards, input channels, U-Net, training and evaluation.

Tensors are (N, C, H, W) float32; numpy arrays at the edges keep the axes of `itof` and `scenegen`.
"""

from model.augmentation import Augmentation, Draws, Warp
from model.batches import Batch, BatchMaker, TensorRows
from model.calibration import ThresholdCurve
from model.evaluation import EvaluationError, evaluate
from model.feed import MEMORY_PART, Feed, machine_bytes, window_rows
from model.groups import GroupTable, group_tables
from model.inputs import CHANNELS, InputSpec, fit_input_spec
from model.interruption import Interruption
from model.loss import LOSS_TARGETS, LOSSES, NightLoss, intersection_over_union
from model.loss_watch import LossError, LossWatch
from model.measurement_files import Measurement, MeasurementError, read_measurement
from model.metrics import (
    ImageMetrics,
    Statistics,
    Summary,
    image_metrics,
    mask_iou,
    no_object_metrics,
    summarise,
)
from model.onnx_export import ExportError, OnnxCheck, export_onnx
from model.optimisation import Optimisation, learning_rate
from model.order import rows_by_piece, shuffled_windows, windows_in_order, without_first
from model.pointclouds import object_points, write_point_cloud
from model.prediction import Prediction, Predictor, load
from model.prediction_files import PredictedImage, PredictionError, predict_file
from model.processes import Processes, is_first_process, joined_processes
from model.readout import Readout
from model.renders import RenderedScene, ShardError, read_render
from model.results import Report
from model.rows import RowBlock, RowLayout
from model.run_folder import RunConfig, RunError, run_settings
from model.scene_result import SceneResult
from model.settings import (
    DEVICES,
    PRECISIONS,
    SCHEDULES,
    DeviceError,
    TrainSettings,
    choose_device,
    settings_from_dict,
    training_preset,
)
from model.shards import ShardManifest, Shards, open_shards
from model.training import TrainingResult, train
from model.training_refusals import TrainingError
from model.training_step import TrainingStep
from model.unet import UNet
from model.wall_view import WallView, wall_view

__all__ = [
    "CHANNELS",
    "DEVICES",
    "LOSSES",
    "LOSS_TARGETS",
    "MEMORY_PART",
    "PRECISIONS",
    "SCHEDULES",
    "Augmentation",
    "Batch",
    "BatchMaker",
    "DeviceError",
    "Draws",
    "EvaluationError",
    "ExportError",
    "Feed",
    "GroupTable",
    "ImageMetrics",
    "InputSpec",
    "Interruption",
    "LossError",
    "LossWatch",
    "Measurement",
    "MeasurementError",
    "NightLoss",
    "OnnxCheck",
    "Optimisation",
    "PredictedImage",
    "Prediction",
    "PredictionError",
    "Predictor",
    "Processes",
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
    "TensorRows",
    "ThresholdCurve",
    "TrainSettings",
    "TrainingError",
    "TrainingResult",
    "TrainingStep",
    "UNet",
    "WallView",
    "Warp",
    "choose_device",
    "evaluate",
    "export_onnx",
    "fit_input_spec",
    "group_tables",
    "image_metrics",
    "intersection_over_union",
    "is_first_process",
    "joined_processes",
    "learning_rate",
    "load",
    "machine_bytes",
    "mask_iou",
    "no_object_metrics",
    "object_points",
    "open_shards",
    "predict_file",
    "read_measurement",
    "read_render",
    "rows_by_piece",
    "run_settings",
    "settings_from_dict",
    "shuffled_windows",
    "summarise",
    "train",
    "training_preset",
    "wall_view",
    "window_rows",
    "windows_in_order",
    "without_first",
    "write_point_cloud",
]
