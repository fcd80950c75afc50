"""K-distributed clutter: the mean echo itself varies from patch to patch of the ground.

I = mu tau Exp(1) with tau ~ Gamma(nu, 1 / nu): scintillation index 1 + 2 / nu (Abraham & Lyons,
IEEE J. Oceanic Eng. 27 (2002), 800).  tau is a field of the world, made of a lattice of Gaussian
values (interpolated at unit variance) through the gamma distribution's quantiles, so it is smooth
and stays with the ground as speckle does.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from pydantic.dataclasses import dataclass

from factory.distribution import Positive, number
from factory.field.signal import Floats, Ping, gaussian_table
from factory.settings import STRICT

_STEPS, _REACH = 32_768, 5.5


@dataclass(frozen=True, config=STRICT)
class TextureSettings:
    """Keys of `noise.texture`.

    shape: nu of the K distribution; 0.5 is very spiky, above 20 it is nearly Rayleigh.
    patch_m: size of the patches on the ground, metres.
    """

    enabled: bool = True
    shape: Positive = number(5)
    patch_m: Positive = number(0.2)


def texture(
    field: Floats, ping: Ping, rng: np.random.Generator, *, shape: float, patch_m: float
) -> Floats:
    """The field, every bin that a surface fills weakened or strengthened by sqrt(tau)."""
    from factory.field import kernels

    scene = ping.scatterers
    normal = np.empty(len(scene.filled), np.float32)
    key = int(rng.integers(2**32))
    kernels.lattice(scene.filled_world_m / patch_m, key, gaussian_table(), normal)
    factor = np.ones(field.shape[-2] * field.shape[-1], np.float32)
    factor[scene.filled] = np.sqrt(gamma_of_normal(normal, shape))
    return field * factor.reshape(ping.shape)


def gamma_of_normal(normal: Floats, shape: float) -> Floats:
    """Gamma(nu, 1 / nu) values at the quantiles of standard normal ones; mean 1."""
    step = (np.clip(normal, -_REACH, _REACH) + _REACH) * ((_STEPS - 1) / (2 * _REACH))
    return np.asarray(_quantiles(shape)[np.rint(step).astype(np.intp)])


@lru_cache(maxsize=64)
def _quantiles(shape: float) -> Floats:
    from scipy import special  # slow to import

    normal = np.linspace(-_REACH, _REACH, _STEPS)
    return np.asarray(special.gammaincinv(shape, special.ndtr(normal)) / shape, np.float32)
