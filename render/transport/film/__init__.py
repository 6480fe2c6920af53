"""Positions on the film: pixels, the lattice, pixels with edges. Numpy only; may import nothing of NIGHT."""
