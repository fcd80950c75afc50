"""Decibels of every weights file that ships, on images that never change.

Real frames: the first eight of examples/didson/lamprey.avi, which no weights learned from, against
the mean of the others, inside the fan after one gain and offset.  Procedural pairs:
golden_pairs.npz, two with the paper's points and two of drawn devices, from places that no training
saw, denoised as a command denoises single images.  Figures may rise; a fall of more than _MAY_LOSE
dB is a fault.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array, Float32s
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.adapting.adapting import psnr_after_levels
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.pretrained import shipped
from simnfnd.models.recordings.fan_finder import find_geometry
from tests.project_files import ROOT

RECORDING = ROOT / "examples" / "didson" / "lamprey.avi"
PAIRS = Path(__file__).with_name("golden_pairs.npz")
_FRAMES = 8
_MAY_LOSE = 0.03

GOLDEN = {
    "simnfnd": {"frame": 2.989, "mean of 4": 0.817, "sonar": 4.335, "points": 0.287},
    "simnfnd-paper": {"points": 8.967},
}
"""What each gains, dB."""


@lru_cache(maxsize=1)
def frames(path: Path = RECORDING) -> tuple[Float32s, FanGeometry]:
    """(T, H, W) float32 in 0..1, and the fan."""
    video = cv2.VideoCapture(str(path))
    actual: list[Array] = []
    while len(actual) < _FRAMES and (read := video.read())[0]:
        actual.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2GRAY))
    geometry = find_geometry(actual[0])
    assert geometry is not None
    return np.stack(actual).astype(np.float32) / 255, geometry


def target(members: range) -> Float32s:
    """The mean of the other frames, NaN outside the fan."""
    observed, geometry = frames()
    others = [number for number in range(len(observed)) if number not in members]
    sector = geometry.maps(0, 0, *observed.shape[1:])["sector"] > 0
    return np.where(sector, observed[others].mean(axis=0), np.nan).astype(np.float32)


def pairs(kind: str) -> list[tuple[Float32s, Float32s, FanGeometry]]:
    """(noisy, clean, geometry) of procedural images, `points` or `sonar`."""
    with np.load(PAIRS) as stored:
        return [
            (
                stored[f"{kind}{number}.noisy"].astype(np.float32) / 255,
                stored[f"{kind}{number}.clean"].astype(np.float32) / 255,
                geometry_of(str(stored[f"{kind}{number}.geometry"])),
            )
            for number in range(2)
        ]


def geometry_of(text: str) -> FanGeometry:
    stated = json.loads(text)
    return FanGeometry(**{**stated, "beam_azimuths_rad": tuple(stated["beam_azimuths_rad"])})


def psnr(image: Float32s, reference: Float32s) -> float:
    return float(-10 * np.log10(np.square(image - reference).mean()))


def denoised_alone(denoise: Denoiser, image: Float32s, geometry: FanGeometry) -> Array:
    return Denoising(denoise, frames=1).denoise_image(image, lambda _: geometry).image


def figures(name: str) -> dict[str, float]:
    """What a file gains, dB: on single frames, on means of seven, on procedural images."""
    denoise = Denoiser(name, "cpu")
    observed, geometry = frames()
    single: list[float] = []
    several: list[float] = []
    for members in (range(2, 3), range(5, 6), range(4), range(4, 8)):
        noisy = observed[members.start : members.stop].mean(axis=0)
        denoised = denoise(noisy, geometry, frames=len(members))
        wished = target(members)
        gain = psnr_after_levels(denoised, wished) - psnr_after_levels(noisy, wished)
        (single if len(members) == 1 else several).append(gain)
    actual = {"frame": float(np.mean(single)), "mean of 4": float(np.mean(several))}
    for kind in ("sonar", "points"):
        gains = [
            psnr(denoised_alone(denoise, noisy, geometry), clean) - psnr(noisy, clean)
            for noisy, clean, geometry in pairs(kind)
        ]
        actual[kind] = float(np.mean(gains))
    return actual


@pytest.mark.parametrize("name", sorted(shipped()))
def test_weights_that_ship_keep_their_decibels(name: str) -> None:
    actual = figures(name)
    assert GOLDEN.keys() == shipped().keys()
    short = {key: round(actual[key], 3) for key, least in GOLDEN[name].items()}
    assert all(actual[key] > least - _MAY_LOSE for key, least in GOLDEN[name].items()), short
