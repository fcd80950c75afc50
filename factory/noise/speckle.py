"""Grain of the complex field: speckle, its texture on the ground, haze, and scintillation."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ..distribution import AnyNumber, NonNegative, Positive
from ..errors import FrameError
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected, between
from ..imaging.moving import static_index
from ..imaging.scatterers import camera_of, grid_of
from ..imaging.signal import (
    Floats,
    Ping,
    Signal,
    add_white_noise,
    beamform,
    gaussian_table,
    scattered,
)
from ..settings import STRICT
from ..sonar import array

Words = npt.NDArray[np.uint32]
Doubles = npt.NDArray[np.float64]

# Edge of a world cell over what the device tells apart; power is then within 0.15 dB.
_CELL = 0.3
_MOST_POINTS = 1 << 25
# Where a beam is to be at least a cell wide, as a part of the farthest range.
_NEAR = 0.25
_STEPS, _REACH = 1024, 5.5
# For the three places of a cell's point in it.
_SALTS = np.array([0x68BC21EB, 0x02E5BE93, 0x967A889B], np.uint32)
_NEPERS_PER_DB = np.log(10) / 10  # of intensity


@dataclass(frozen=True, config=STRICT)
class SpeckleSettings(EffectSettings):
    """Keys of `noise.speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes 0.3 of a range bin or of the resolution
        c / 2B, whichever is shorter.  A cell that reaches over several of them loses power and
        makes neighbouring bins alike.  Cells smaller than the camera's pixels lose their hold on
        the scene when the camera moves.
    """

    looks: Positive = parameter(1, "1")
    scatterer_m: NonNegative = parameter(0, "m")


def speckle(signal: Signal, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float) -> Signal:
    """The scatterers' complex field instead of the mean power of the echoes.

    Every scatterer has a complex circular Gaussian coefficient that depends on its cell of the
    world alone, and the device's point-spread gives the field its grain: fully developed, amplitude
    Rayleigh, intensity exponential (Goodman, Speckle Phenomena in Optics, ch. 3); the average of L
    looks is gamma-distributed, L its shape.  Without poses every frame has a field of its own.
    """
    scene = ping.scatterers
    names, shares = scene.world_cells(scatterer_m or _CELL * min(ping.bin_m, ping.resolution_m))
    points = scene.bins, np.sqrt(scene.powers), names, shares, np.empty(0, np.uint16)
    return scattered(ping, rng, looks, points)


def expect_speckle(
    state: Expected, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float
) -> None:
    """Speckle varies from ping to ping, except for its static part.

    A field that keeps the part p of its power from ping to ping is sqrt(p) f + sqrt(1 - p) g, f the
    same in all pings and g new in each.  This ping shows that sum, so f is, with another g,
    sqrt(p) (the sum) + sqrt(1 - p) g.
    """
    static_part = state.standing
    state.echo += (1 - static_part) * state.steady
    state.steady[:] = 0
    state.looks = max(round(looks), 1)
    if static_part == 0:
        return

    no_signal = Signal(state.steady, state.steady)
    # The first field has the stream of the effect, and so it is the one that the image shows.
    shown = speckle(no_signal, ping, rng, looks=looks, scatterer_m=scatterer_m).field
    renewed = speckle(no_signal, ping, rng, looks=looks, scatterer_m=scatterer_m).field
    static_field = np.float32(np.sqrt(static_part)) * shown
    static_field += np.float32(np.sqrt(1 - static_part)) * renewed
    intensity = (beamform(static_field, ping) ** 2).sum(axis=1).mean(axis=0)
    state.steady[:] = static_part * intensity


SPECKLE = Effect(SpeckleSettings, speckle, "echo", "speckle", "world", expected=expect_speckle)


@dataclass(frozen=True, config=STRICT)
class PathSpeckleSettings(EffectSettings):
    """Keys of `noise.path_speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes about what the device tells apart.
    """

    looks: Positive = parameter(1, "1")
    scatterer_m: NonNegative = parameter(0, "m")


def path_speckle(
    signal: Signal, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float
) -> Signal:
    """Speckle of a sonar that moves: every echo has the phase of the way there and back.

    The cells of the world are points whose echoes turn with their range.  A sonar at rest sees the
    same speckle, to the byte; one that moves across loses it over about half its aperture, one that
    turns or moves along keeps it for longer (Goodman, ch. 5).  Needs frames with poses, of a range
    window that stays the same (sonar.range.auto=false).  Raises FrameError when cells are too many.
    """
    cell_m = scatterer_m or edge_m(ping)
    names, powers, sonar_m = _static_points(ping, cell_m)
    for own in ping.scatterers.moving:
        moving = own.points(ping.scatterers.powers[own.index], cell_m)
        names = np.concatenate([names, moving.names])
        powers = np.concatenate([powers, moving.powers])
        sonar_m = np.concatenate([sonar_m, _in_sonar_axes(ping, moving.camera_m)], axis=1)
    ahead, left, up = sonar_m
    ground = ahead * ahead + left * left
    range_m = np.sqrt(ground + up * up)
    on_ground, near_m, bins_per_m, rows, edges, *_ = grid_of(ping.window, ping.sonar)
    away_m = np.sqrt(ground) if on_ground else range_m
    row = np.floor((away_m - near_m) * bins_per_m)
    beam = np.searchsorted(edges, -left / range_m, side="right") - 1
    beams = ping.sonar.beams
    seen = (ahead > 0) & (row >= 0) & (row < rows) & (beam >= 0) & (beam < beams)
    bins = (row[seen].astype(np.int32) * beams + beam[seen]).astype(np.int32)
    # Wavelengths of the two-way path.
    turns = range_m[seen] * (2000 * ping.sonar.frequency_khz / ping.water.sound_speed_m_s())
    phases = ((turns - np.floor(turns)) * 65536.0).astype(np.uint16)
    points = bins, np.sqrt(powers[seen]), names[seen], np.empty(0, np.float32), phases
    return scattered(ping, rng, looks, points)


def _static_points(ping: Ping, cell_m: float) -> tuple[Words, Floats, Doubles]:
    """The cells of the static scene as one point each: names, powers, (3, N) in sonar axes.

    Raises FrameError when cells are too many.
    """
    from ..imaging import kernels  # loads numba

    scene = ping.scatterers
    pose = np.ascontiguousarray(scene.world_from_camera[:3])
    kept = static_index(scene.moving, len(scene.pixels))
    where, power = (scene.pixels[kept], scene.parts[kept]), scene.powers[kept]
    given = (where, power, camera_of(scene.frame), pose, cell_m)
    nothing = np.empty(0, np.uint32), np.empty(0, np.float32), np.empty((0, 3), np.int32)
    points = kernels.gather(*given, nothing)
    if points > _MOST_POINTS:
        raise FrameError(
            f"{scene.frame.ref.name}: {points} points for cells of {1000 * cell_m:.2g} mm; set "
            "noise.path_speckle.scatterer_m to larger ones"
        )
    slots = 1 << int(points).bit_length()
    names, powers = np.zeros(slots, np.uint32), np.zeros(slots, np.float32)
    table = names, powers, np.empty((slots, 3), np.int32)
    kernels.gather(*given, table)
    # Only what lies in the picture, each cell as one point in it, which is the cell's own.
    kept = np.flatnonzero(powers > 0)
    names, powers, places = names[kept], powers[kept], table[2][kept]
    x, y, z = (
        (places[:, axis] + (kernels.scrambled(names ^ salt) >> np.uint32(8)) * 2.0**-24) * cell_m
        for axis, salt in enumerate(_SALTS)
    )
    # World axes to sonar axes (x forward, y left, z up).
    turn = ping.sonar.mount.rotation_sonar_from_camera()
    seen_from = turn @ np.linalg.inv(scene.world_from_camera)[:3]
    seen_from[:, 3] -= turn @ ping.sonar.mount.position_camera_m()
    rows = [m[0] * x + m[1] * y + m[2] * z + m[3] for m in seen_from]
    return names, powers, np.stack(rows)


def _in_sonar_axes(ping: Ping, camera_m: Doubles) -> Doubles:
    """(3, N) places in sonar axes of (N, 3) places in camera axes."""
    mount = ping.sonar.mount
    turn = mount.rotation_sonar_from_camera()
    x, y, z = (camera_m - mount.position_camera_m()).T
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in turn])


def edge_m(ping: Ping) -> float:
    """Edge of a cell that suits the device, a power of two, metres: what the device tells apart."""
    length_m = max(ping.bin_m, ping.resolution_m)
    width_m = _NEAR * ping.window.range_max_m * array.beam_width_sine(ping.sonar.array)
    return float(2.0 ** np.floor(np.log2(min(length_m, width_m))))


PATH_SPECKLE = Effect(
    PathSpeckleSettings, path_speckle, "echo", "speckle", "world", expected=expect_speckle
)


@dataclass(frozen=True, config=STRICT)
class VolumeSettings(EffectSettings):
    """Keys of `noise.volume`.

    strength_db: volume scattering strength, dB re 1/m; clear water -70, a harbour -45.
    """

    strength_db: AnyNumber = parameter(-60, "dB")


def volume(signal: Signal, ping: Ping, rng: Rng, *, strength_db: float) -> Signal:
    """Volume reverberation: the water's own scatterers, with the grain that every echo has.

    They drift, so every frame has a haze of its own.
    """
    along, across = haze_intensity(ping, strength_db)
    add_white_noise(signal.field, rng, np.sqrt(along), np.sqrt(across))
    return signal


def haze_intensity(ping: Ping, strength_db: float) -> tuple[Floats, Floats]:
    """Expected intensity of the haze in each bin: (range_bins,) times (beams,) float32.

    s_v V / r^4 of the volume V = r^2 theta phi dr: theta the bin's bearings, phi the integral of
    the two-way vertical pattern (Urick 1983, ch. 8).
    """
    sonar = ping.sonar
    upright_rad = array.vertical_width_rad(sonar.vfov_deg, sonar.array)
    range_m = np.maximum(ping.range_m, ping.bin_m)
    along = 10 ** (strength_db / 10) * upright_rad * ping.bin_m / range_m**2 * ping.scatterers.loss
    across_rad = np.gradient(sonar.beam_centres_rad())
    return along.astype(np.float32), across_rad.astype(np.float32)


def expect_volume(state: Expected, ping: Ping, rng: Rng, *, strength_db: float) -> None:
    """The haze's intensity, which the point-spread leaves as it is."""
    along, across = haze_intensity(ping, strength_db)
    state.echo += along[:, None] * across


VOLUME = Effect(VolumeSettings, volume, "echo", "haze", systematic=expect_volume)


@dataclass(frozen=True, config=STRICT)
class TextureSettings(EffectSettings):
    """Keys of `noise.texture`.

    shape: nu of the K distribution; 0.5 is very spiky, above 20 it is nearly Rayleigh.
    patch_m: size of the patches on the ground, metres.
    """

    shape: Positive = parameter(5, "1")
    patch_m: Positive = parameter(0.2, "m")


def texture(field: Floats, ping: Ping, rng: Rng, *, shape: float, patch_m: float) -> Floats:
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


def expect_texture(state: Expected, ping: Ping, rng: Rng, *, shape: float, patch_m: float) -> None:
    """What is in the bins that a surface fills varies."""
    state.shape = shape
    total = (state.echo + state.steady).reshape(-1)
    filled, _ = ping.scatterers.surface
    state.textured.reshape(-1)[filled] = total[filled]


def texture_here(state: Expected, ping: Ping, rng: Rng, **given: float) -> None:
    """The patches as they are: a property of the ground, which stays when speckle goes."""
    patches = texture(np.ones(ping.shape, np.float32), ping, rng, **given) ** 2
    state.echo *= patches
    state.steady *= patches


TEXTURE = Effect(
    TextureSettings, texture, "beam", None, "world", expected=expect_texture, realised=texture_here
)


@dataclass(frozen=True, config=STRICT)
class ScintillationSettings(EffectSettings):
    """Keys of `noise.scintillation`.

    sigma_db: standard deviation of a sample's level, dB.
    """

    sigma_db: NonNegative = parameter(3, "dB")


def scintillation(field: Floats, ping: Ping, rng: Rng, *, sigma_db: float) -> Floats:
    """Every sample's level trembles from ping to ping, whatever its level is.

    In recordings of a scene at rest what changes is nearly Gaussian on a logarithmic display and as
    strong in bright bins as in dark ones.  Here each intensity gets a log-normal factor, median 1.
    """
    level_nepers = rng.standard_normal(field.shape[-2:], np.float32)
    level_nepers *= np.float32(sigma_db * _NEPERS_PER_DB / 2)  # of amplitude
    field *= np.exp(level_nepers, out=level_nepers)
    return field


def expect_scintillation(state: Expected, ping: Ping, rng: Rng, *, sigma_db: float) -> None:
    """A display of levels shows the median; one of powers shows a little more."""
    state.scintillation_nepers2 += (sigma_db * _NEPERS_PER_DB) ** 2


SCINTILLATION = Effect(
    ScintillationSettings, scintillation, "picture", "speckle", expected=expect_scintillation
)
