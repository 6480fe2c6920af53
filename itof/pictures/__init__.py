"""Pictures and point clouds of depth maps, and pictures of the wall's phases.

May import the other modules of `itof` and `itof.wall`.
"""
