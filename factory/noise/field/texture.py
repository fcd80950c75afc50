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

from ...distribution import Positive
from ...imaging.coherent.expected import Expected, between
from ...imaging.coherent.signal import Floats, Ping, gaussian_table
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT

_STEPS, _REACH = 1024, 5.5


@dataclass(frozen=True, config=STRICT)
class TextureSettings(EffectSettings):
    """Keys of `noise.texture`.

    shape: nu of the K distribution; 0.5 is very spiky, above 20 it is nearly Rayleigh.
    patch_m: size of the patches on the ground, metres.
    """

    shape: Positive = parameter(5, "1")
    patch_m: Positive = parameter(0.2, "m")


def texture(
    field: Floats, ping: Ping, rng: np.random.Generator, *, shape: float, patch_m: float
) -> Floats:
    """The field, every bin that a surface fills weakened or strengthened by sqrt(tau)."""
    from ...imaging.coherent import kernels  # loads numba

    scene = ping.scatterers
    filled, points_m = scene.surface
    normal = np.empty(len(filled), np.float32)
    key = int(rng.integers(2**32))
    lattice_from_camera = np.ascontiguousarray(scene.world_from_camera[:3] / patch_m)
    kernels.lattice(points_m, lattice_from_camera, key, gaussian_table(), normal)
    planes = field.reshape(-1, field.shape[-2] * field.shape[-1])
    patches = np.sqrt(gamma_of_normal(normal, shape))
    for plane in planes:
        plane[filled] *= patches
    return field


def gamma_of_normal(normal: Floats, shape: float) -> Floats:
    """Gamma(nu, 1 / nu) values at the quantiles of standard normal ones; mean 1."""
    steps = np.float32((_STEPS - 1) / (2 * _REACH))
    reach = np.float32(_REACH)
    return between(_quantiles(shape), (np.clip(normal, -reach, reach) + reach) * steps)


@lru_cache(maxsize=64)
def _quantiles(shape: float) -> Floats:
    from scipy import special  # slow to import

    normal = np.linspace(-_REACH, _REACH, _STEPS)
    return np.asarray(special.gammaincinv(shape, special.ndtr(normal)) / shape, np.float32)


def expect_texture(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, shape: float, patch_m: float
) -> None:
    """What is in the bins that a surface fills varies."""
    expected.shape = shape
    total = (expected.echo + expected.steady).reshape(-1)
    filled, _ = ping.scatterers.surface
    expected.textured.reshape(-1)[filled] = total[filled]


def realise_texture(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, shape: float, patch_m: float
) -> None:
    """The patches as they are: a property of the ground, which stays when speckle goes."""
    weights = np.zeros((1, 2, *ping.shape), np.float32)
    weights[0, 0] = 1
    patches = texture(weights, ping, rng, shape=shape, patch_m=patch_m)[0, 0] ** 2
    expected.echo *= patches
    expected.steady *= patches


TEXTURE = Effect(
    TextureSettings, texture, "beam", "world", expected=expect_texture, realised=realise_texture
)
