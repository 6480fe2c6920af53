"""iToF measurements: phasors, phase, depth and its metrics, channels, and EXR files of images and transients.

Imports no other package of NIGHT but the basement (`disk`, `processes`). Sub-packages: `exr` (image
files), `files` (measurement files), `capture` (raw frames of a camera), `sensor` (a model of one), `wall`
(the relay wall in a measurement) and `pictures`. The names below are loaded at their first use.

Arrays are numpy, image axes are (..., H, W, F) or (..., H, W, T), lengths are metres of *optical path*
(out and back) where a name says `opl`, and metres of depth (half of it) where it says `depth`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
