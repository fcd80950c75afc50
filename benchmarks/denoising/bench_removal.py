"""Removal by choice: how much of one artefact goes, and how much of all else stays."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.report import Options, Section, Table
from benchmarks.shared import run_factory
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.imaging.contract import ARTEFACTS
from simnfnd.factory.scenes import open_reader
from simnfnd.models.data.any_device import DeviceSource
from simnfnd.models.denoise.weighing.in_turn import asked_denoiser
from simnfnd.models.removal import DEFAULT

PLACES, PICTURES, LEAST = 12, 48, 1e-5
ASKED: tuple[tuple[str, ...], ...] = (
    *((one,) for one in ARTEFACTS),
    ("speckle", "haze"),
    ("speckle", "spokes"),
    (),
)
"""Words of --remove; none: the usual."""
Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Removed:
    """One artefact of one picture: PSNR to the picture without it, before and after, dB.

    gone: part of the artefact that the change contains.  kept: 1 less the rest of the change,
    squared, over the variance of the picture without the artefact.
    """

    before_db: float
    after_db: float
    gone: float
    kept: float


def measure(options: Options) -> Section:
    """The weights that ship on procedural places that no training of theirs has seen."""
    places, pictures = options.amount(PLACES, 2), options.amount(PICTURES, 6)
    with tempfile.TemporaryDirectory() as folder:
        config, frames = rendered(Path(folder), places)
        rows = [_row(config, frames, asked, pictures) for asked in ASKED]
    columns = ("removed", "pictures", "dB before", "dB after", "gone, %", "all else kept, %")
    note = (
        "Pictures of drawn devices. Each is denoised with --remove of the artefacts and compared "
        "with itself without them, under the same random streams; only pictures with some count. "
        f"The usual: {', '.join(DEFAULT)}."
    )
    return Section((Table(columns, tuple(rows)),), note)


def rendered(folder: Path, places: int) -> tuple[FactoryConfig, tuple[FrameRef, ...]]:
    """Frames of places that no training has seen, rendered; and what draws devices for them."""
    words = [
        *("experiment=any_sonar", "render=embree", f"scenes.locations={places}"),
        *("scenes.first_location=5000", "scenes.frames_per_location=1"),
        *(f"cache.dir={folder}/cache", f"dataset.dir={folder}/set", "split.test_fraction=0"),
        *("dataset.preview_pairs=0", "devices.quiet_share=0", "devices.jpeg_share=0"),
    ]
    run_factory(words)
    config = compose_config(words)
    return config, tuple(open_reader(config.scenes).discover().frames)


def _row(
    config: FactoryConfig, frames: tuple[FrameRef, ...], asked: tuple[str, ...], pictures: int
) -> tuple[str | float, ...]:
    removed, chosen = asked or DEFAULT, ", ".join(asked) or "the usual"
    source = Asked(config, frames, removed)
    denoise = asked_denoiser(None, "cpu", asked or None)
    found = []
    for number in range(pictures):
        sample = source.sample(number % len(source), number)
        assert sample.clean is not None
        assert sample.geometry is not None
        artefact = sample.noisy - sample.clean
        if np.square(artefact).mean() < LEAST:
            continue
        result = denoise(sample.noisy, sample.geometry)
        inside = sample.geometry.maps(0, 0, *result.shape)["sector"] > 0
        found.append(_removed(sample.noisy[inside], sample.clean[inside], result[inside]))
    if not found:
        return (chosen, 0, float("nan"), float("nan"), float("nan"), float("nan"))
    return (
        chosen,
        len(found),
        float(np.mean([one.before_db for one in found])),
        float(np.mean([one.after_db for one in found])),
        100 * float(np.mean([one.gone for one in found])),
        100 * float(np.mean([one.kept for one in found])),
    )


def _removed(noisy: Floats, without: Floats, result: Floats) -> Removed:
    artefact, change = noisy - without, noisy - result
    gone = float((change * artefact).sum() / np.square(artefact).sum())
    rest = np.square(change - gone * artefact).mean() / max(float(without.var()), LEAST)
    return Removed(_db(noisy - without), _db(result - without), gone, 1 - float(rest))


def _db(difference: Floats) -> float:
    return float(-10 * np.log10(np.square(difference).mean() + 1e-10))


class Asked(DeviceSource):
    """Pictures whose targets are all without the same artefacts."""

    def __init__(
        self, config: FactoryConfig, frames: tuple[FrameRef, ...], removed: tuple[str, ...]
    ) -> None:
        super().__init__(config, frames, patch=192, weaker=0, choices=0, seed=9)
        self._removed = removed

    def removed(self, *names: int | str) -> tuple[str, ...]:
        """Always those."""
        return self._removed
