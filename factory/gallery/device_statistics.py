"""Speckle of every device as it ships: its mean power, and how alike range bins are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..cli.compose import compose_config
from ..imaging.coherent.received import received
from ..imaging.coherent.scene import FieldScene
from ..noise.draws import StreamNames, draw
from ..pairs import observe
from .statistics import constant_field

_PICTURES = 8
_EDGE_M = 0.12
# The constant field is brought to where every device sees it: 2.2 to 4.4 m.
_NEARER = np.float32(0.55)


def device_table(devices: Iterable[str]) -> str:
    """Mean intensity over the expected one and correlation of range bins, as Markdown."""
    lines = [
        "| device | mean over expected, dB | correlation of bins | that the pulse gives |",
        "|---|---:|---:|---:|",
    ]
    for device in devices:
        power_db, found, pulse = speckle_of(device)
        lines.append(f"| `{device}` | {power_db:.2f} | {found:.2f} | {pulse:.2f} |")
    return "\n".join(lines) + "\n"


def speckle_of(device: str) -> tuple[float, float, float]:
    """Power over the expected, dB; correlation of neighbouring bins; that which the pulse gives."""
    config = compose_config(["experiment=physical", f"sonar={device}"])
    frame, rendered = constant_field()
    scene = observe(replace(frame, depth_m=frame.depth_m * _NEARER), rendered, config).scene
    assert isinstance(scene, FieldScene)
    ping, echoes = scene.ping, scene.ping.scatterers.power
    rows, beams = (np.flatnonzero(echoes.any(axis=axis)) for axis in (1, 0))
    edge, side = int(_EDGE_M / ping.bin_m) + 1, max(len(beams) // 5, 2)
    inner = np.s_[rows[0] + edge : rows[-1] - edge, beams[0] + side : beams[-1] - side]
    expected = (ping.expected * ping.gain[:, None])[inner]
    pictures = []
    for variant in range(_PICTURES):
        effects = draw(config.noise, config.seed, StreamNames.single(variant)).effects
        speckle = [effect for effect in effects if effect.name == "speckle"]
        pictures.append(received(ping, speckle)[inner] ** 2 / expected)
    intensity = np.stack(pictures).astype(np.float64)
    beside = ((intensity[:, 1:] - 1) * (intensity[:, :-1] - 1)).mean()
    kernel = np.append(ping.kernel, 0).astype(np.float64)
    pulse = float((kernel[1:] @ kernel[:-1] / (kernel @ kernel)) ** 2)
    correlation = float(beside / ((intensity - 1) ** 2).mean())
    return float(10 * np.log10(intensity.mean())), correlation, pulse
