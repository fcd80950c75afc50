"""SAR2SAR, a network for the speckle of satellite radar, with the weights of its authors.

Dalsasso, Denis, Tupin: SAR2SAR, IEEE JSTARS 14, 2021; package `deepdespeckling` 0.8 (MIT), which
holds the weights.  It has never seen a sonar: the row says what a foreign speckle network does.

    pip install --no-deps deepdespeckling==0.8

Without its dependencies, because opencv-python would overwrite opencv-python-headless.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from importlib.resources import as_file, files
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import ndimage

from ....factory.common.errors import FactoryError
from ...metrics.measure import Grey

_PACKAGE = "deepdespeckling"
_STRIDE_PX = 32  # the network halves its input five times
# The network takes (log amplitude - least) / (most - least), as its package normalises images.
_LEAST_LOG = -1.429329123112601
_MOST_LOG = 10.089038980848645
_DARKEST = np.float32(1 / 255)  # radar images have no black, of which the network makes artefacts
_BLACK_PX = 9  # squares of this side without any echo stay black


def sar2sar(image: Grey, amplitude: float) -> Grey:
    """(H, W) in 0..1 denoised.

    amplitude: what white is taken for on the radar's scale, which reaches 24,000.
    Raises FactoryError where the package or torch is missing.
    """
    for module in (_PACKAGE, "torch"):
        if find_spec(module) is None:
            raise FactoryError(
                f"sar2sar: needs {module}; pip install --no-deps {_PACKAGE}==0.8 torch"
            )
    import torch

    height, width = image.shape
    padding = [(0, -side % _STRIDE_PX) for side in image.shape]
    radar = np.pad(np.maximum(image, _DARKEST), padding, mode="symmetric") * amplitude
    normalised = (np.log(radar) - _LEAST_LOG) / (_MOST_LOG - _LEAST_LOG)
    network = _load_network()
    network.height, network.width = normalised.shape
    with torch.inference_mode():
        prediction = network(torch.from_numpy(normalised.astype(np.float32)))[0, 0].numpy()

    logarithm = np.clip(prediction, 0, None) * (_MOST_LOG - _LEAST_LOG) + _LEAST_LOG
    denoised = np.exp(logarithm)[:height, :width] / amplitude
    has_echoes = ndimage.maximum_filter(image, _BLACK_PX) > 0
    return np.asarray(np.where(has_echoes, denoised, 0), np.float32)


@lru_cache(maxsize=1)
def _load_network() -> Any:
    """The network of the package, on the CPU, in evaluation mode."""
    import torch

    network = import_module(f"{_PACKAGE}.model").Model(
        torch.device("cpu"), height=_STRIDE_PX, width=_STRIDE_PX
    )
    # The file also holds numbers of numpy, which torch reads only on request.
    make_scalar = np.float64(0).__reduce__()[0]
    number_types: list[Any] = [
        (make_scalar, "numpy.core.multiarray.scalar"),
        np.dtype,
        type(np.dtype("f8")),
    ]
    weights = files(_PACKAGE) / "sar2sar" / "saved_model" / "sar2sar.pth"
    with as_file(weights) as path, torch.serialization.safe_globals(number_types):
        content = torch.load(path, map_location="cpu", weights_only=True)
    network.load_state_dict(content["model_state_dict"])
    return network.eval()
