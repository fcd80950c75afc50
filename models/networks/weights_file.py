"""A weights file as NumPy arrays: safetensors with the description of the network in its header."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open

from ...factory.errors import FactoryError

FORMAT = "simnfnd-denoiser/1"
KEY = "simnfnd"
"""One header entry, because safetensors does not keep the order of several."""

Header = dict[str, Any]
Arrays = dict[str, npt.NDArray[Any]]


def read_header(path: str | Path) -> Header:
    """What a weights file says of itself: `model`, and `training` where it is known.

    Raises FactoryError when it is absent, not a weights file, or of another program.
    """
    return _read(path, with_arrays=False)[0]


def read_weights(path: str | Path) -> tuple[Header, Arrays]:
    """The header and the weights by their names, floats in 32 bits.

    Nothing in the file is executed.  Raises FactoryError as `read_header` does, and for a file that
    holds NaN or infinity.
    """
    header, arrays = _read(path, with_arrays=True)
    for name, values in arrays.items():
        # A picture made with them would be all NaN, or black, and nothing would say why.
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise FactoryError(
                f"weights={path}: {name} holds NaN or infinity; train again, or take another file"
            )
    return header, arrays


def _read(path: str | Path, with_arrays: bool) -> tuple[Header, Arrays]:
    if not Path(path).is_file():
        raise FactoryError(f"weights={path}: no such file; train one with `simnfnd train`")
    arrays: Arrays = {}
    try:
        with safe_open(path, framework="np") as file:
            header = json.loads((file.metadata() or {}).get(KEY, "{}"))
            for name in file.keys() if with_arrays else ():
                values = file.get_tensor(name)
                arrays[name] = values.astype(np.float32) if values.dtype.kind == "f" else values
    except (SafetensorError, OSError, RecursionError, ValueError, TypeError) as error:
        raise FactoryError(f"weights={path}: not a safetensors file, or a damaged one") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise FactoryError(
            f"weights={path}: does not describe its network ({FORMAT}); not made by this program"
        )
    if not isinstance(header.get("model"), dict):
        raise FactoryError(f"weights={path}: do not fit their network: no `model` in the header")
    return header, arrays
