from .judging.evaluation import evaluate
from .judging.exposures import judge_exposures
from .network.channels import InputSpec
from .network.readout import Readout
from .network.unet import UNet
from .prediction.measurement_check import check_file
from .prediction.onnx_export import export_onnx
from .prediction.prediction_files import predict_file
from .prediction.predictor import Predictor, load
from .refinement.judged_refinement import refine_split
from .refinement.refined_file import refine
from .run_folder.compact import compact
from .run_folder.networks import networks
from .run_folder.run_config import fine_tuning_settings, run_settings
from .run_folder.shipped import shipped_runs
from .settings.keys import merged
from .settings.presets import training_preset
from .settings.train_settings import TrainSettings, settings_from_dict
from .training.loop import train

__all__ = [
    "InputSpec",
    "Predictor",
    "Readout",
    "TrainSettings",
    "UNet",
    "check_file",
    "compact",
    "evaluate",
    "export_onnx",
    "fine_tuning_settings",
    "judge_exposures",
    "load",
    "merged",
    "networks",
    "predict_file",
    "refine",
    "refine_split",
    "run_settings",
    "settings_from_dict",
    "shipped_runs",
    "train",
    "training_preset",
]
