"""Virtual lights on the hidden surface, and how exactly they give the hidden signal. May import `kernels`."""
