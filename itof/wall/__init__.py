"""The relay wall in a measurement: where it is, and whether the measurement can be one of it.

`wall_fit` and `wall_search` find the wall; `plausibility` judges a measurement by it. A network corrects its
input by `self_calibration`, a fit of a few steps that starts at the known corner. May import the other
modules of `itof`, which do not import this sub-package.
"""
