"""The network as a function: what it is fed, its layers, how its output is read, and how it is judged.

Here: input channels (`channels`) and the wall they refer to (`wall_view`), the U-Net, the readout of mask and
depth, the training loss, the metrics. May import `model.settings`, `itof` and `scenegen`; no other wing of
`model`.
"""
