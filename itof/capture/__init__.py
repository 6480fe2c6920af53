"""Captures: raw frames of a real camera, as the phasors that prediction reads, and what is wrong with them.

`sidecar` says what a file of frames does not say, `importing` makes a measurement file of frames, `checking`
judges it without a network. May import the other sub-packages of `itof`.
"""
