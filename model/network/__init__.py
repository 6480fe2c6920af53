"""The network as a function: input channels, layers, readout, loss and metrics.

`channels` and `wall_view` prepare the input, `unet` is the network, `readout` reads mask and depth from its
output, `loss` is minimised in training, `metrics` compares depth maps with ground truth. May import `itof`,
`scenegen` and `model.settings`; no other sub-package of `model`.
"""
