"""Writing measurement files that prediction reads."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np

from itof.arrays import Numbers

ENDINGS: Final = (".npz", ".h5", ".hdf5")


def write_measurement(partial: Path, arrays: Mapping[str, Numbers]) -> None:
    """Write arrays by name to a temporary file, as ``.npz`` or HDF5 by its ending."""
    stream = BytesIO()  # which has room: on a full disk, zipfile says too much, and HDF5 ends the process
    if partial.suffix.lower() == ".npz":
        np.savez(stream, **dict(arrays))
    else:
        import h5py  # which takes a tenth of a second to load

        with h5py.File(stream, "w") as file:
            for name, values in arrays.items():
                file[name] = values
    partial.write_bytes(stream.getbuffer())
