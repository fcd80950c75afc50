"""The statistics of an echo that is the same everywhere: what a noise model makes of it.

Of a rough surface a sonar receives fully developed speckle: amplitude Rayleigh, whose equivalent
number of looks (mean / standard deviation)^2 is 3.66.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from ..cli.compose import compose_config
from ..distribution import Distribution
from ..frame import Frame, FrameRef, Intrinsics
from ..imaging.coherent.received import received
from ..imaging.coherent.scene import FieldScene
from ..imaging.coherent.signal import beamform_power
from ..noise.draws import StreamNames, draw
from ..noise.registry import FIELD_EFFECTS
from ..pairs import make_pair, observe
from ..render.base import Rendered

NEAR_M, FAR_M = 4.0, 8.0
_VARIANTS = 8
# At the edges a picture lacks what lies beyond them.
_EDGE = 20
_HEADROOM = 0.05
_DEVICE = (
    "sonar.hfov_deg=24", "sonar.vfov_deg=20", "sonar.beams=128", "sonar.range_bins=192",
    "sonar.range={auto: false, min_m: 4, max_m: 8}", "sonar.image.layout=polar",
    "dataset.dtype=float32",
)  # fmt: skip
# Peers, measured by running their noise on a constant field: ENL of the amplitude, distance to
# Rayleigh.
PEERS: dict[str, tuple[float, float]] = {
    "NPS-DAVE": (3.67, 0.005),
    "HoloOcean (multiplicative noise 0.2)": (6.25, 0.121),
    "OceanSim": (7.0, 0.135),
    "Cerqueira et al.": (10.1, 0.192),
    "smarc": (100.0, 0.451),
    "Stonefish": (627.0, 0.550),
}


@dataclass(frozen=True)
class Statistics:
    """Of amplitudes over their expectation.

    enl: (mean / standard deviation)^2.  ks: Kolmogorov-Smirnov distance to the Rayleigh
    distribution of the same power.  scintillation: variance of intensity over its squared mean.
    decibels: standard deviation of the level, dB.
    """

    enl: float
    ks: float
    scintillation: float
    decibels: float


def constant_field(
    name: str = "0",
    pose: npt.NDArray[np.float64] | None = None,
    power: float = 1.0,
    size: tuple[int, int] = (960, 640),
) -> tuple[Frame, Rendered]:
    """A frame of (rows, columns); slant range grows evenly upwards, all echoes have one power."""
    rows, columns = size
    camera = Intrinsics(columns / (2 * np.tan(np.deg2rad(12.2))), 40_000.0, columns / 2, rows / 2)
    across = (np.arange(columns) - camera.cx) / camera.fx
    down = ((np.arange(rows) - camera.cy) / camera.fy)[:, None]
    square = 1 + across**2 + down**2
    range_m = (FAR_M + (NEAR_M - FAR_M) * (np.arange(rows) + 0.5) / rows)[:, None]
    depth_m = (range_m / np.sqrt(square)).astype(np.float32)
    radiance = (power * square**1.5).astype(np.float32)
    rgb = np.zeros((*depth_m.shape, 3), np.uint8)
    frame = Frame(FrameRef("made", "constant", name), rgb, depth_m, camera, pose)
    return frame, Rendered(radiance, depth_m > 0)


def profiles() -> Iterator[tuple[str, Statistics]]:
    """The statistics of our two profiles, and of parts of the physical one."""
    # A few loud points decide the moments of a picture, so each draw is one measurement.
    singly = [_of([one]) for one in _points()]
    middle = [
        float(np.median([getattr(one, item.name) for one in singly])) for item in fields(Statistics)
    ]
    yield "`experiment=simnfnd`, median of 16 pictures", Statistics(*middle)
    off = [f"noise.{name}.enabled=false" for name in FIELD_EFFECTS]
    grain = ["noise.speckle.enabled=true"]
    yield "`experiment=physical`, speckle alone", _of(_field([*off, *grain]))
    k = [*off, *grain, "noise.texture={enabled: true, shape: 5, patch_m: 0.005}"]
    yield "`experiment=physical`, speckle and texture of nu = 5", _of(_field(k))
    yield "`experiment=physical`, all effects", _of(_field([]))


def statistics(amplitude: npt.NDArray[np.floating]) -> Statistics:
    """Statistics of amplitudes of any shape."""
    from scipy import stats  # slow to import

    flat = np.asarray(amplitude, np.float64).ravel()
    intensity = flat**2
    scale = float(np.sqrt(intensity.mean() / 2))
    lit = intensity[intensity > 0]
    return Statistics(
        enl=float((flat.mean() / flat.std()) ** 2),
        ks=float(stats.kstest(flat, stats.rayleigh(scale=scale).cdf).statistic),
        scintillation=float(intensity.var() / intensity.mean() ** 2),
        decibels=float((10 * np.log10(lit)).std()),
    )


def table() -> str:
    """The statistics of our profiles and of the peers, as Markdown."""
    lines = [
        "| noise model | ENL of amplitude (3.66) | distance to Rayleigh | scintillation index (1) "
        "| level, dB std (5.57) |",
        "|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {name} | {found.enl:.2f} | {found.ks:.3f} | {found.scintillation:.2f} "
        f"| {found.decibels:.2f} |"
        for name, found in profiles()
    ]
    lines += [f"| {name} | {enl:g} | {ks:.3f} | | |" for name, (enl, ks) in PEERS.items()]
    return "\n".join(lines) + "\n"


def _of(amplitudes: list[npt.NDArray[np.float32]]) -> Statistics:
    inner = slice(_EDGE, -_EDGE)
    return statistics(np.stack([one[inner, inner] for one in amplitudes]))


def _points() -> list[npt.NDArray[np.float32]]:
    """Noisy pictures of the paper's profile, on a scale on which none saturates."""
    linear = (
        f"sonar.transfer={{kind: linear, reference: {_HEADROOM}}}",
        "sonar.tvg_db_per_decade=0",
    )
    words = ["experiment=simnfnd", "scenes=seabed", *_DEVICE, *linear]
    config = compose_config([*words, "sonar.projection=slant_range"])
    # Strengths are fractions of full scale, which is so much higher now.
    weaker = {
        name: replace(block, strength=replace(block.strength, values=_scaled(block.strength)))
        for name in ("multipath", "azimuth", "range_arc", "background")
        for block in [getattr(config.noise, name)]
    }
    config = replace(config, noise=replace(config.noise, **weaker))
    frame, rendered = constant_field()
    observed = observe(frame, rendered, config)
    return [
        np.asarray(make_pair(observed, variant, config).noisy, np.float32)
        for variant in range(2 * _VARIANTS)
    ]


def _scaled(strength: Distribution) -> tuple[float, ...]:
    return tuple(_HEADROOM * value for value in strength.values)


def _field(words: list[str]) -> list[npt.NDArray[np.float32]]:
    """Received amplitudes of the physical profile over their expectation."""
    config = compose_config(["experiment=physical", *_DEVICE, *words])
    frame, rendered = constant_field()
    scene = observe(frame, rendered, config).scene
    assert isinstance(scene, FieldScene)
    ping = scene.ping
    expected = np.sqrt(beamform_power(ping.scatterers.power, ping) * ping.gain[:, None])
    found = []
    for variant in range(_VARIANTS):
        names = StreamNames.of(frame.ref, variant, has_pose=False)
        draws = draw(config.noise, config.seed, names)
        found.append(received(ping, draws.effects) / expected)
    return found
