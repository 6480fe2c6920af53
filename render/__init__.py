"""What the camera would measure: transients, phasors and ground truth, rendered with Mitsuba 3.

Importing this package neither loads Mitsuba nor sets a variant. The names below are loaded when they are
first used: `RenderSettings` does not import what renders.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
