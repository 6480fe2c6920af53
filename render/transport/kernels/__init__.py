"""DrJit kernels. Import the modules late, after a Mitsuba variant is set.

Numbers that change from scene to scene are passed as arrays or through `dr.opaque`: a Python number becomes a
literal in the kernel, which is then compiled again (docs/science/design.md, DrJit). Imports nothing of NIGHT.
"""
