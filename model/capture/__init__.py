"""Captures: raw frames of a real camera, as the phasors that prediction reads, and what is wrong with them.

`sidecar` says what a file of frames does not say, `importing` makes a measurement file of frames, `checking`
judges it without a network. May import `itof`, `scenegen` and what `model.prediction` reads measurement files
and draws walls with; no network and no torch.
"""
