"""What the paper's recipe, ``data/training/paper.toml``, has and our default has not.

``loss``: the losses of Re and Im of the mirrored scene, or of its depth. ``augmentation`` and
``enlarged_set``: the changes of its training images. docs/science/paper.md compares them with the paper. May
import `model.data`, `model.network` and `model.settings`.
"""
