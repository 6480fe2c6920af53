"""The paper's recipe: what a training of Caligiuri et al. 2024 has and our default has not.

Its values are in ``data/training/paper.toml``. ``loss`` and ``lovasz``: the losses of Re and Im of the
mirrored scene, or of its depth. ``augmentation`` and ``enlarged_set``: the changes of its training images.
Its input channels are `itof.network_channels`, its network is `model.network.unet.UNet` with five levels and
blocks of one pixel, and `model.network.readout` reads its output. docs/paper.md compares statement by
statement. May import `model.data`, `model.network` and `model.settings`.
"""
