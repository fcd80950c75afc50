"""Clutter: patches of the ground that scatter more or less than their surroundings."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Distribution, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected, interpolate_table
from ..imaging.signal import Ping, gaussian_table

_QUANTILE_COUNT = 1024
_QUANTILE_REACH = 5.5  # standard deviations on either side


@dataclass(frozen=True, config=STRICT)
class TextureSettings(EffectSettings):
    """Keys of `noise.texture`.

    shape: nu of the K distribution; 0.5 is very spiky, above 20 it is nearly Rayleigh.
    patch_m: size of the patches on the ground, metres.
    """

    shape: Annotated[Distribution, within(0.01, 1e6), as_written] = parameter(5, "1")
    patch_m: Annotated[Distribution, within(1e-3, 100, "m"), as_written] = parameter(0.2, "m")


def texture(field: Float32s, ping: Ping, rng: Rng, *, shape: float, patch_m: float) -> Float32s:
    """K-distributed clutter: every bin that a surface fills, times sqrt(tau).

    I = mu tau Exp(1) with tau ~ Gamma(nu, 1 / nu): scintillation index 1 + 2 / nu (Abraham & Lyons,
    IEEE J. Oceanic Eng. 27 (2002), 800).  tau is a smooth field of the world, a lattice of Gaussian
    values through the gamma distribution's quantiles, and stays with the ground as speckle does.
    """
    from ..imaging import kernels  # loads numba

    scene = ping.scatterers
    filled, points_m = scene.surface
    normal = np.empty(len(filled), np.float32)
    key = int(rng.integers(2**32))
    lattice_from_camera = np.ascontiguousarray(scene.world_from_camera[:3] / patch_m)
    kernels.lattice(points_m, lattice_from_camera, key, gaussian_table(), normal)
    patches = np.sqrt(gamma_of_normal(normal, shape))
    for plane in field.reshape(-1, ping.shape[0] * ping.shape[1]):
        plane[filled] *= patches
    return field


def gamma_of_normal(normal: Float32s, shape: float) -> Float32s:
    """Return Gamma(nu, 1 / nu) values (mean 1) at the quantiles of standard normal ones."""
    steps_per_sigma = np.float32((_QUANTILE_COUNT - 1) / (2 * _QUANTILE_REACH))
    reach = np.float32(_QUANTILE_REACH)
    position = (np.clip(normal, -reach, reach) + reach) * steps_per_sigma
    return interpolate_table(_quantiles(shape), position)


@lru_cache(maxsize=64)
def _quantiles(shape: float) -> Float32s:
    """Return the gamma distribution's quantiles at equal steps of a standard normal variable."""
    from scipy import special  # slow to import

    normal = np.linspace(-_QUANTILE_REACH, _QUANTILE_REACH, _QUANTILE_COUNT)
    return np.asarray(special.gammaincinv(shape, special.ndtr(normal)) / shape, np.float32)


def expect_texture(state: Expected, ping: Ping, rng: Rng, *, shape: float, patch_m: float) -> None:
    """Record the texture's shape and the expected intensity that it varies.

    Its patches average out, so they change no expected intensity here.
    """
    state.shape = shape
    total = (state.echo + state.steady).reshape(-1)
    filled, _ = ping.scatterers.surface
    state.textured.reshape(-1)[filled] = total[filled]


def realise_texture(state: Expected, ping: Ping, rng: Rng, **parameters: float) -> None:
    """Multiply the expected intensities by the patches of this sample.

    Texture is a property of the ground: an image without speckle still shows it.
    """
    patches = texture(np.ones(ping.shape, np.float32), ping, rng, **parameters) ** 2
    state.echo *= patches
    state.steady *= patches


TEXTURE = Effect(
    TextureSettings,
    texture,
    stage="beam",
    artefact=None,
    scope="world",
    expected=expect_texture,
    realised=realise_texture,
)
