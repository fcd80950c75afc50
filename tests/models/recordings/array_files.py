"""Files of arrays as NumPy and MATLAB write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io


def write_array(path: Path, pictures: Any, **others: Any) -> Path:
    """Pictures (N, H, W) or (N, H, W, 3) named `frames`, and what else lies beside them.

    a.npz, a.mat: compressed; b.npz, b.mat: plain.
    """
    arrays = {"frames": np.asarray(pictures), **others}
    plain = path.stem == "b"
    if path.suffix == ".npy":
        np.save(path, pictures)
    elif path.suffix == ".npz":
        (np.savez if plain else np.savez_compressed)(path, **arrays)
    else:
        named = {name: matlab(array) for name, array in arrays.items()}
        scipy.io.savemat(path, named, do_compression=not plain)
    return path


def matlab(array: Any) -> Any:
    """An array of pictures as MATLAB keeps them, the number of the picture last."""
    array = np.asarray(array)
    return np.moveaxis(array, 0, -1) if array.ndim > 2 else array
