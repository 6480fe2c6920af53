"""The physics: from a loaded Mitsuba scene to phasors, time bins and ground truth.

Here: the rendering methods `many-light` and `path`, and the mirror trick. `lights` makes virtual lights,
`passes` computes what the pixels get, `film` divides the image, and `kernels` runs in DrJit. Works on scenes
in memory, not on files or datasets. May import `render.options`, `render.walls` and `itof`; nothing else of
`render`.
"""
