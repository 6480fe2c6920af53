"""An iToF camera: the electrons that light makes, taps, noise, and the phasors that come out.

`camera` measures, `settings` describe it. May import the other modules of `itof`, which do not import this
sub-package.
"""
