"""What each pixel gets: the direct return, the hidden signal, and both over time.

May import `kernels`, `film`, `lights` and `method`.
"""
