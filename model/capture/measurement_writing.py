"""Writing measurement files that prediction reads."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scenegen import whole_file

ENDINGS: Final = (".npz", ".h5", ".hdf5")


def write_measurement(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays by name, as ``.npz`` or HDF5 by the ending of the path; complete or not at all."""
    with whole_file(path) as partial:
        if path.suffix.lower() == ".npz":
            stream = BytesIO()  # which has room; on a full disk, zipfile prints more than one sentence
            np.savez(stream, **dict(arrays))
            partial.write_bytes(stream.getbuffer())
            return
        import h5py  # which takes a tenth of a second to load

        with h5py.File(partial, "w") as file:
            for name, values in arrays.items():
                file[name] = values
