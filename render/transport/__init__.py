"""The physics: from a loaded Mitsuba scene to phasors, time bins and ground truth.

Here: the rendering methods `many-light` (light pass, gather pass, DrJit kernels) and `path`, and the mirror
trick. Works on scenes in memory, not on files or datasets. May import `render.options` and `itof`; no other
wing of `render`.
"""
