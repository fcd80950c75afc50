"""Convolutional sparse coding by ADMM.

After the abstract of Vishwakarma (2022, convolutional sparse representation of sonar images, solved
by ADMM); the algorithm is Wohlberg's (IEEE TIP 25(1), 2016): minimise over coefficient maps x_m

    1/2 |sum_m d_m * x_m - s|^2 + strength * sum_m |x_m|_1

where s is the picture without its slow part.  The dictionary of that paper is learned and not
public; here d_m are fixed: the two-dimensional cosines of 5x5 pixels without the constant one.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy import fft

from ..base import Gray

Floats = npt.NDArray[np.float32]
Spectra = npt.NDArray[np.complex64]

_SIDE = 5
_MARGIN = 16
_SLOW = 5.0  # weight of the gradients in the slow part, as in Wohlberg's examples


def convolutional(image: Gray, strength: float, iterations: int) -> Gray:
    """(H, W) in 0..1 denoised.  strength: weight of the sparsity, as a grey value."""
    height, width = image.shape
    shape = tuple(fft.next_fast_len(size + 2 * _MARGIN, real=True) for size in image.shape)
    after = [size - old - _MARGIN for size, old in zip(shape, image.shape, strict=True)]
    padded = np.pad(image, [(_MARGIN, extra) for extra in after], mode="symmetric")
    slow = _slow_part(padded)
    result = slow + reconstructed(coded(padded - slow, strength, iterations))
    return result[_MARGIN : _MARGIN + height, _MARGIN : _MARGIN + width]


def atoms() -> Floats:
    """(24, 5, 5): the dictionary, each atom of length 1."""
    k, n = np.mgrid[0:_SIDE, 0:_SIDE]
    basis = np.cos(np.pi * (2 * n + 1) * k / (2 * _SIDE)) * np.sqrt(2 / _SIDE)
    basis[0] /= np.sqrt(2)
    both = np.einsum("ai,bj->abij", basis, basis).reshape(-1, _SIDE, _SIDE)
    return np.asarray(both[1:], dtype=np.float32)


def _slow_part(values: Floats) -> Floats:
    """The l that minimises 1/2 |l - values|^2 + _SLOW / 2 |gradient of l|^2, periodic."""
    rows, columns = values.shape
    down = 2 - 2 * np.cos(2 * np.pi * np.fft.fftfreq(rows))[:, None]
    right = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(columns))[None]
    spectrum = fft.rfft2(values) / (1 + _SLOW * (down + right)).astype(np.float32)
    return np.asarray(fft.irfft2(spectrum, s=values.shape), dtype=np.float32)


@lru_cache(maxsize=4)
def _spectra(shape: tuple[int, int]) -> tuple[Spectra, Floats]:
    """Spectra of the atoms, (24, H, W / 2 + 1), and the sum of their powers."""
    spectra = fft.rfft2(atoms(), s=shape, axes=(1, 2))
    return spectra, np.sum(np.abs(spectra) ** 2, axis=0, dtype=np.float32)


def reconstructed(sparse: Floats) -> Floats:
    """sum_m d_m * x_m, (H, W), of coefficient maps (24, H, W); all round."""
    shape = (sparse.shape[1], sparse.shape[2])
    spectrum = np.sum(_spectra(shape)[0] * fft.rfft2(sparse, axes=(1, 2)), axis=0)
    return np.asarray(fft.irfft2(spectrum, s=shape), dtype=np.float32)


def coded(values: Floats, strength: float, iterations: int) -> Floats:
    """The coefficient maps x_m, (24, H, W), after that many steps of ADMM from nothing."""
    shape = (values.shape[0], values.shape[1])
    dictionary, power = _spectra(shape)
    rho = np.float32(50 * strength + 0.5)  # penalty of ADMM, as Wohlberg recommends for 0..1
    target = fft.rfft2(values)
    sparse = np.zeros((len(dictionary), *shape), dtype=np.float32)
    dual = np.zeros_like(sparse)
    threshold = np.float32(strength) / rho
    for _ in range(iterations):
        # Each frequency alone: (d d^H + rho) x = d^H s + rho (z - u), one rank by Sherman-Morrison.
        inner = fft.rfft2(sparse - dual, axes=(1, 2))
        missing = (target - np.sum(dictionary * inner, axis=0)) / (power + rho)
        inner += np.conj(dictionary) * missing
        smooth = fft.irfft2(inner, s=shape, axes=(1, 2))
        dual += smooth
        sparse = np.sign(dual) * np.maximum(np.abs(dual) - threshold, 0)
        dual -= sparse
    return sparse
