"""From iToF measurements to depth maps: data, network, training, prediction and evaluation.

Tensors are (N, C, H, W) float32; numpy arrays keep the axes of `itof`. The names below are loaded when they
are first used: predicting does not import what training needs.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
