"""The network as a function: input channels, layers, readout and loss.

`channels` and `bounce_images` make the input, `unet` is the network, `readout` reads mask and depth from the
phasor that it predicts, `mask_and_depth` from probabilities and depths. `loss` is the loss of the latter;
those of the paper are in `model.paper`. May import `itof`, `scenegen` and `model.settings`; no other
sub-package of `model`.
"""
