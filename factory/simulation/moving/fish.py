"""A parametric fish: a body at rest, and the wave that bends it as it swims."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.array_types import Float64s, Floats
from ..meshes.triangle_mesh import Mesh, grid_triangles, join, mesh

_STATIONS = 28
_AROUND = 14
_WIDTH = 0.55
"""Width of the body over its height."""
_STEM = 0.82
"""Where the body ends and the tail fin begins, as a part of the length."""
_FIN_STEPS = 7
_SIDE_ALBEDO = 0.5


def fish_mesh(length_m: float, body_height: float) -> Mesh:
    """A fish at rest, head towards +x, centred at the origin.

    body_height: height of the body over its length.  Proportions of a trout; with a small height
    it is an eel.
    """
    along = np.linspace(0, 1, _STATIONS)
    # Blunt in front, thin behind, and a stem to which the fin is attached.
    profile = np.sqrt(np.clip(along, 0, 1)) * (1 - along) ** 0.75
    half_height = 0.5 * body_height * np.maximum(profile / profile.max(), 0.12 * (along > 0.1))
    half_height[0] = half_height[-1] = 0
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    x = (0.5 - along * _STEM)[:, None] + 0 * angle
    y = _WIDTH * half_height[:, None] * np.cos(angle)
    z = half_height[:, None] * np.sin(angle)
    body_points = np.stack([x, y, z], axis=-1) * length_m
    body = mesh(body_points.reshape(-1, 3), grid_triangles(_STATIONS, _AROUND, closed=True))
    fin = _tail_fin(length_m, body_height)
    return join([body, fin]).tinted((_SIDE_ALBEDO,) * 3)


def _tail_fin(length_m: float, body_height: float) -> Mesh:
    """A thin upright fan from the end of the body to the end of the fish."""
    along = np.linspace(0, 1, _FIN_STEPS)
    half_height = body_height * (0.06 + 0.34 * along)
    x = 0.5 - _STEM + 0.02 - along * (1 - _STEM + 0.02)
    upper = np.stack([x, 0 * x, half_height], axis=-1)
    lower = np.stack([x, 0 * x, -half_height], axis=-1)
    points = np.stack([lower, 0.5 * (lower + upper), upper], axis=1) * length_m
    return mesh(points.reshape(-1, 3), grid_triangles(_FIN_STEPS, 3))


@dataclass(frozen=True)
class SwimmingWave:
    """The wave that runs along a swimming fish.

    The side-to-side amplitude is 0.02 - 0.0825 s + 0.1625 s^2 lengths at the part s of the length
    behind the head, and the wave is about one length long (Videler & Hess, J. Exp. Biol. 109
    (1984), 209).

    length_m: of the fish.  beat_hz: of the tail.  phase_rad: at time 0.
    """

    length_m: float
    beat_hz: float
    phase_rad: float

    def bent(self, rest_m: Floats, time_s: float) -> Float64s:
        """(N, 3) places of (N, 3) points of the fish at rest."""
        points = np.array(rest_m, np.float64)
        behind = 0.5 - points[:, 0] / self.length_m
        amplitude = 0.02 - 0.0825 * behind + 0.1625 * behind**2
        turns = self.beat_hz * time_s - behind
        angle = 2 * np.pi * turns + self.phase_rad
        points[:, 1] += self.length_m * amplitude * np.sin(angle)
        return points


def love_target_strength_db(length_m: float, frequency_khz: float) -> float:
    """Target strength of a fish, dB re 1 m^2: 19.1 log10 L - 0.9 log10 f - 62.0, L in cm, f in kHz.

    Love, "Target strength of an individual fish at any aspect", JASA 62 (1977), 1397: the mean over
    aspects from above; a fish seen from its side is stronger, from its head weaker.
    """
    return float(19.1 * np.log10(100 * length_m) - 0.9 * np.log10(frequency_khz) - 62.0)
