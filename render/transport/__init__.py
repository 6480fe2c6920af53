"""The physics: from a loaded Mitsuba scene to phasors, time bins and ground truth.

Here: the rendering methods `many-light` (light pass, gather pass, DrJit kernels) and `path`, and the mirror
trick. Knows scenes in memory, no files and no datasets. May import `render.options`, `itof`; no other wing of
`render`.
"""
