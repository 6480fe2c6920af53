"""Rendering: transients, phasors and ground truth of the scenes of a dataset, with Mitsuba 3.

Here: settings, options of the methods, the device, `rendering` (one scene to its files) and `mirror_panels`
(the mirror trick in pictures). Sub-packages: `transport` (the physics of one scene), `batch` (the light of
many scenes at once, and of solids in a corner), `walls` (their edges), `farm` (work on many scenes),
`products` (what is made of renders), `pairs` (datasets of measured pairs). May import `scenegen` and `itof`.
The names below are loaded at their first use, so importing this package does not load Mitsuba.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
