"""Ground truth by a mirror: pairs of real captures become a dataset that trains and judges networks.

A measurement of the corner is followed by a capture of a mirror that hangs on the relay wall. `truth` makes a
depth map of the second, `pairs` writes datasets. Needs no Mitsuba; may
import `scenegen` and `itof`.
"""
