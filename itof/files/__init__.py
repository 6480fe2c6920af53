"""Measurement files: phasors from NumPy, MATLAB and HDF5 files, read in a process of their own.

`mat_reading` reads MATLAB's version 5; version 7.3 is HDF5, which `hdf5_reading` reads. Captures may also be
pictures, videos and bare numbers. `array_claims` refuses arrays that are too large before they are read. May
import the other modules of `itof` but no sub-package except `itof.exr`.
"""
