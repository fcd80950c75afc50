"""Grain of the complex field: speckle, its texture on the ground, haze, and scintillation."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ..distribution import AnyNumber, NonNegative, Positive
from ..errors import FrameError
from ..imaging.cells import places_in_cells
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected, interpolate_table
from ..imaging.ghosts import GhostScatterers
from ..imaging.moving import static_index
from ..imaging.scatterers import camera_rays, polar_bins, shares
from ..imaging.signal import (
    Floats,
    Ping,
    PointEchoes,
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
Phases = npt.NDArray[np.uint16]

# Edge of a world cell as a fraction of the device's resolution; power is then within 0.15 dB.
_CELL_OF_RESOLUTION = 0.3
_MOST_POINTS = 1 << 25
# Fraction of the farthest range from which on a beam is at least a cell wide.
_CELL_WIDE_FROM = 0.25
_QUANTILE_COUNT = 1024
_QUANTILE_REACH = 5.5  # standard deviations on either side
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
    return _scatter_cells(ping, rng, looks, scatterer_m)


def _scatter_cells(ping: Ping, rng: Rng, looks: float, scatterer_m: float) -> Signal:
    """Return the field of all scatterers, those of one cell with the cell's coefficient."""
    scene = ping.scatterers
    # A cell that reaches over several bins or resolution lengths would lose power.
    finest_m = min(ping.bin_m, ping.resolution_m)
    cell_m = scatterer_m or _CELL_OF_RESOLUTION * finest_m
    cells, amplitude_factors = scene.world_cells(cell_m)
    no_phases = np.empty(0, np.uint16)
    echoes = PointEchoes(scene.bins, np.sqrt(scene.powers), cells, amplitude_factors, no_phases)
    if scene.ghosts is not None:
        echoes = _with_ghosts(echoes, scene.ghosts, cell_m)
    return scattered(ping, rng, looks, echoes)


def _with_ghosts(echoes: PointEchoes, ghosts: GhostScatterers, cell_m: float) -> PointEchoes:
    """Return the echoes, then those of the ghosts."""
    from ..imaging import kernels  # loads numba

    names = ghosts.names(cell_m)
    return PointEchoes(
        np.concatenate([echoes.bins, ghosts.bins]),
        np.concatenate([echoes.amplitudes, np.sqrt(ghosts.powers)]),
        np.concatenate([echoes.cells, names]),
        np.concatenate([echoes.shares, shares(names, kernels.scrambled(names))]),
        echoes.phases,
    )


def expect_speckle(
    state: Expected, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float
) -> None:
    """Split the expected power into speckle that averages out and speckle that does not.

    The part p of the power (`standing`) is the same speckle in every ping: it stays in `steady` and
    keeps its grain.  The rest moves to `echo`, whose speckle is new in each ping and averages out.

    The field of a ping is sqrt(p) f + sqrt(1 - p) g, f the same in all pings and g new in each.
    This image shows such a sum, so f given the image is sqrt(p) (the sum) + sqrt(1 - p) g with
    another g.
    """
    static_part = state.standing
    state.echo += (1 - static_part) * state.steady
    state.steady[:] = 0
    state.looks = max(round(looks), 1)
    if static_part == 0:
        return

    # The first draw from the effect's random stream is the field that the image shows.
    shown = _scatter_cells(ping, rng, looks, scatterer_m).field
    renewed = _scatter_cells(ping, rng, looks, scatterer_m).field
    static_field = np.float32(np.sqrt(static_part)) * shown
    static_field += np.float32(np.sqrt(1 - static_part)) * renewed
    intensity = (beamform(static_field, ping) ** 2).sum(axis=1).mean(axis=0)
    state.steady[:] = static_part * intensity


SPECKLE = Effect(
    SpeckleSettings,
    speckle,
    stage="echo",
    artefact="speckle",
    scope="world",
    expected=expect_speckle,
)


@dataclass(frozen=True, config=STRICT)
class PathSpeckleSettings(EffectSettings):
    """Keys of `noise.path_speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes about what the device tells apart.
    """

    looks: Positive = parameter(1, "1")
    scatterer_m: NonNegative = parameter(0, "m")


class CellPoints(NamedTuple):
    """The world's cells as one point each.

    cells: (N,) uint32 names of the cells.
    powers: (N,) float32 intensity over the source level, without absorption.
    sonar_m: (3, N) float64 places in sonar axes (x forward, y left, z up), metres.
    """

    cells: Words
    powers: Floats
    sonar_m: Doubles


def path_speckle(
    signal: Signal, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float
) -> Signal:
    """Speckle of a moving sonar: every echo has the phase of its two-way path.

    The cells of the world are points whose echoes turn in phase with their range.  A sonar at rest
    sees the same speckle in every frame, to the byte.  One that moves across its view loses the
    speckle over about half its aperture; one that turns or moves along its view keeps it for longer
    (Goodman, ch. 5).  Needs frames with poses, and a range window that stays the same
    (sonar.range.auto=false).  Raises FrameError when there are too many cells.
    """
    cell_m = scatterer_m or default_cell_m(ping)
    static_points = _place_static_points(ping, cell_m)
    moving_points = _place_moving_points(ping, cell_m)
    points = _join([static_points, *moving_points, *_place_ghost_points(ping, cell_m)])

    bins = polar_bins(points.sonar_m, ping.window, ping.sonar)
    in_window = bins >= 0
    ahead_m, left_m, up_m = points.sonar_m[:, in_window]
    range_m = np.sqrt(ahead_m * ahead_m + left_m * left_m + up_m * up_m)
    echoes = PointEchoes(
        bins[in_window],
        np.sqrt(points.powers[in_window]),
        points.cells[in_window],
        np.empty(0, np.float32),
        _two_way_phases(range_m, ping),
    )
    return scattered(ping, rng, looks, echoes)


def _two_way_phases(range_m: Doubles, ping: Ping) -> Phases:
    """Return the phase of the path to each range and back, (N,) uint16 65536ths of a turn."""
    wavelengths_per_m = 2000 * ping.sonar.frequency_khz / ping.water.sound_speed_m_s()
    turns = range_m * wavelengths_per_m
    fraction = turns - np.floor(turns)
    return np.asarray(fraction * 65536.0).astype(np.uint16)


def _join(parts: list[CellPoints]) -> CellPoints:
    """Return the points of all parts as one record."""
    if len(parts) == 1:
        return parts[0]
    return CellPoints(
        np.concatenate([part.cells for part in parts]),
        np.concatenate([part.powers for part in parts]),
        np.concatenate([part.sonar_m for part in parts], axis=1),
    )


def _place_moving_points(ping: Ping, cell_m: float) -> list[CellPoints]:
    """Return for each moving object the cells of its own axes as one point each.

    The points move, turn and bend with the object; see `MovingScatterers`.
    """
    points_by_object = []
    for moving in ping.scatterers.moving:
        points = moving.points(ping.scatterers.powers[moving.index], cell_m)
        sonar_m = _in_sonar_axes(ping, points.camera_m)
        points_by_object.append(CellPoints(points.names, points.powers, sonar_m))
    return points_by_object


def _place_ghost_points(ping: Ping, cell_m: float) -> list[CellPoints]:
    """Return the cells of mirror images as one point each; see `GhostScatterers`."""
    ghosts = ping.scatterers.ghosts
    if ghosts is None:
        return []
    points = ghosts.points(cell_m)
    return [CellPoints(points.names, points.powers, points.sonar_m)]


def _place_static_points(ping: Ping, cell_m: float) -> CellPoints:
    """Return the cells of the static scene as one point each, at a random place of the cell.

    Raises FrameError when there are too many cells.
    """
    from ..imaging import kernels  # loads numba

    scene = ping.scatterers
    world_from_camera = np.ascontiguousarray(scene.world_from_camera[:3])
    static = static_index(scene.moving, len(scene.pixels))
    gather_arguments = (
        (scene.pixels[static], scene.parts[static]),
        scene.powers[static],
        tuple(camera_rays(scene.frame)),
        world_from_camera,
        cell_m,
    )
    # With a table of no slots the loop only counts.
    point_count = kernels.gather(*gather_arguments, _cell_table(0))
    if point_count > _MOST_POINTS:
        raise FrameError(
            f"{scene.frame.ref.name}: {point_count} points for cells of {1000 * cell_m:.2g} mm; "
            "set noise.path_speckle.scatterer_m to larger ones"
        )
    slots = 1 << int(point_count).bit_length()
    table = _cell_table(slots)
    kernels.gather(*gather_arguments, table)

    names, all_powers, corners = table
    has_echo = np.flatnonzero(all_powers > 0)
    cells = names[has_echo]
    x, y, z = (corners[has_echo].T + places_in_cells(cells)) * cell_m
    mount = ping.sonar.mount
    sonar_from_camera = mount.rotation_sonar_from_camera()
    sonar_from_world = sonar_from_camera @ np.linalg.inv(scene.world_from_camera)[:3]
    sonar_from_world[:, 3] -= sonar_from_camera @ mount.position_camera_m()
    # Spelled out, for a matrix product of many points may round differently on other processors.
    sonar_m = [row[0] * x + row[1] * y + row[2] * z + row[3] for row in sonar_from_world]
    return CellPoints(cells, all_powers[has_echo], np.stack(sonar_m))


def _cell_table(slots: int) -> tuple[Words, Floats, npt.NDArray[np.int32]]:
    """Return an empty hash table as `kernels.gather` fills it: names, powers, cell corners."""
    names = np.zeros(slots, np.uint32)
    powers = np.zeros(slots, np.float32)
    return names, powers, np.empty((slots, 3), np.int32)


def _in_sonar_axes(ping: Ping, camera_m: Doubles) -> Doubles:
    """Return (3, N) places in sonar axes for (N, 3) places in camera axes, metres."""
    mount = ping.sonar.mount
    sonar_from_camera = mount.rotation_sonar_from_camera()
    x, y, z = (camera_m - mount.position_camera_m()).T
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in sonar_from_camera])


def default_cell_m(ping: Ping) -> float:
    """Return the edge of a cell that suits the device's resolution, a power of two, metres."""
    # A cell is one point in one bin here and loses no power: the coarser of both lengths will do.
    length_m = max(ping.bin_m, ping.resolution_m)
    width_m = _CELL_WIDE_FROM * ping.window.range_max_m * array.beam_width_sine(ping.sonar.array)
    return float(2.0 ** np.floor(np.log2(min(length_m, width_m))))


PATH_SPECKLE = Effect(
    PathSpeckleSettings,
    path_speckle,
    stage="echo",
    artefact="speckle",
    scope="world",
    expected=expect_speckle,
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


VOLUME = Effect(VolumeSettings, volume, stage="echo", artefact="haze", systematic=expect_volume)


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
    """Return Gamma(nu, 1 / nu) values (mean 1) at the quantiles of standard normal ones."""
    steps_per_sigma = np.float32((_QUANTILE_COUNT - 1) / (2 * _QUANTILE_REACH))
    reach = np.float32(_QUANTILE_REACH)
    position = (np.clip(normal, -reach, reach) + reach) * steps_per_sigma
    return interpolate_table(_quantiles(shape), position)


@lru_cache(maxsize=64)
def _quantiles(shape: float) -> Floats:
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
    """Add the variance of the log-intensity.

    A logarithmic display shows the median of the fluctuation, one of powers slightly more.
    """
    state.scintillation_nepers2 += (sigma_db * _NEPERS_PER_DB) ** 2


SCINTILLATION = Effect(
    ScintillationSettings,
    scintillation,
    stage="image",
    artefact="speckle",
    expected=expect_scintillation,
)
