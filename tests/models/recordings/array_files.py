"""Files of arrays as NumPy, MATLAB and h5py write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

MATLAB_CLASSES = {"f8": "double", "f4": "single", "u1": "uint8", "u2": "uint16", "i2": "int16"}


def write_array(path: Path, pictures: Any, **others: Any) -> Path:
    """Pictures (N, H, W) or (N, H, W, 3) named `frames`, and what else lies beside them.

    a.npz, a.mat: compressed or of MATLAB 7.3; b.npz, b.mat: plain or of version 7.
    """
    arrays = {"frames": np.asarray(pictures), **others}
    plain = path.stem == "b"
    if path.suffix == ".npy":
        np.save(path, pictures)
    elif path.suffix == ".npz":
        (np.savez if plain else np.savez_compressed)(path, **arrays)
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                chunks = (1, *array.shape[1:]) if array.ndim > 2 else None
                how = {"chunks": chunks, "compression": 4} if chunks else {}
                file.create_dataset(f"sonar/{name}", data=array, **how)
    elif plain:
        scipy.io.savemat(path, {name: matlab(array) for name, array in arrays.items()})
    else:
        _write_matlab_73(path, {name: matlab(array) for name, array in arrays.items()})
    return path


def matlab(array: Any) -> Any:
    """An array of pictures as MATLAB keeps them, the number of the picture last."""
    array = np.asarray(array)
    return np.moveaxis(array, 0, -1) if array.ndim > 2 else array


def _write_matlab_73(path: Path, arrays: dict[str, Any]) -> None:
    """HDF5 behind a header of 512 bytes; axes lie the other way round."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            dataset = file.create_dataset(name, data=array.transpose())
            dataset.attrs["MATLAB_class"] = np.bytes_(MATLAB_CLASSES[array.dtype.str[1:]])
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
