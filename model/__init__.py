"""Neural network from iToF measurements to depth maps: data, training, prediction, evaluation.

Sub-packages: `settings`, `data` (files to batches), `network`, `paper` (what only the paper's recipe has),
`run_folder`, `training`, `prediction`, `refinement` (solids that explain the light) and `judging`.

Tensors are (N, C, H, W) float32; numpy arrays keep the axis order of `itof`. The names below are imported on
first use, so prediction does not import the code that only training needs.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
