"""Whole spokes that the weights for the paper's noise leave in a picture.

Each picture is denoised with its spokes and without them, under the same random streams: what
both results differ by is what is left of the spokes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from benchmarks.report import Options, Section, Table
from benchmarks.shared import run_factory
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.dataset.read.pair_dataset import in_unit_range
from simnfnd.factory.noise.registry import NoiseSettings
from simnfnd.factory.pairs import pair_maker
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.data.renders import resized
from simnfnd.models.denoise.denoiser import load_denoiser

PICTURES, SIZES = 256, (1.0, 2.0)
WEIGHTS = "simnfnd-paper"
VISIBLE, WHOLE = 0.02, 0.5
"""Mean grey value along a bearing from which a spoke can be seen; part left of a whole one."""
Floats = npt.NDArray[np.floating]


def measure(options: Options) -> Section:
    """Procedural places that no training has seen, or with --frame the frames of FLSea VI."""
    pictures = options.amount(PICTURES, 4)
    scenes = (
        ("scenes=flsea", f"scenes.root={options.frame}")
        if options.frame
        else ("scenes=seabed", "scenes.first_location=5000", f"scenes.locations={pictures // 4}")
    )
    with tempfile.TemporaryDirectory() as folder:
        words = [
            *("experiment=simnfnd", "render=embree", *scenes, "dataset.preview_pairs=0"),
            *(f"cache.dir={folder}/cache", f"dataset.dir={folder}/set"),
            *(() if options.frame else ("scenes.frames_per_location=4",)),
        ]
        run_factory(words)
        rows = [_row(words, size, pictures) for size in SIZES]
    columns = (
        *("pixels", "pictures", "with spokes", "spokes", "left of a spoke, %"),
        *("spokes left whole", "pictures with one", "median, highest"),
    )
    note = (
        f"`{WEIGHTS}` at the calibrated noise. A spoke: bearings side by side along which the mean "
        f"grey value is more than {VISIBLE} higher than in the same picture without spokes; left "
        f"whole: more than {100 * WHOLE:.0f} % of it is still there; the last column is how much "
        "these raised their bearings, of the grey scale."
    )
    return Section((Table(columns, tuple(rows)),), note)


def _row(words: list[str], size: float, pictures: int) -> tuple[str | float, ...]:
    config = compose_config(words)
    config = replace(config, sonar=resized(config.sonar, size))
    maker, denoise = pair_maker(config), load_denoiser(WEIGHTS, "cpu")
    frames = open_reader(config.scenes).discover().frames
    found = []
    for number in range(pictures):
        ref, variant = frames[number % len(frames)], number // len(frames)
        (noisy,) = maker.pairs(ref, (variant,))
        (without,) = maker.pairs(ref, (variant,), without_spokes(config.noise))
        geometry = FanGeometry.from_record(config.sonar, noisy.record)
        both = [in_unit_range(pair.noisy) for pair in (noisy, without)]
        results = [denoise(picture, geometry) for picture in both]
        found.append(list(left_of_spokes(both[0] - both[1], results[0] - results[1], geometry)))
    spokes = [spoke for here in found for spoke in here]
    whole = [spoke.height for spoke in spokes if spoke.left > WHOLE]
    return (
        config.sonar.image.height_px,
        pictures,
        sum(bool(here) for here in found),
        len(spokes),
        100 * float(np.mean([spoke.left for spoke in spokes])) if spokes else float("nan"),
        len(whole),
        sum(any(spoke.left > WHOLE for spoke in here) for here in found),
        f"{np.median(whole):.3f}, {max(whole):.3f}" if whole else "",
    )


def without_spokes(noise: NoiseSettings) -> NoiseSettings:
    """The same noise without spokes along bearings."""
    return replace(noise, azimuth=replace(noise.azimuth, enabled=False))


@dataclass(frozen=True)
class Spoke:
    """height: the most that it adds to the mean along a bearing.  left: the part that stayed."""

    height: float
    left: float


def left_of_spokes(before: Floats, after: Floats, geometry: FanGeometry) -> Iterator[Spoke]:
    """Each visible spoke, by the means along its bearings.

    before, after: (H, W), what the spokes add to the noisy and to the denoised picture.
    """
    maps = geometry.maps(0, 0, *before.shape)
    inside = maps["sector"] > 0
    bearing = maps["azimuth_rad"][inside]
    # A bearing for every two pixels of the picture's width: finer ones would have empty ranges.
    edges = np.linspace(bearing.min(), bearing.max(), before.shape[1] // 2)
    beam = np.digitize(bearing, edges)
    pixels = np.maximum(np.bincount(beam), 1)
    added = np.bincount(beam, before[inside]) / pixels
    stayed = np.bincount(beam, after[inside]) / pixels
    runs, count = ndimage.label(added > VISIBLE)
    for run in range(1, count + 1):
        here = runs == run
        yield Spoke(float(added[here].max()), float(stayed[here].sum() / added[here].sum()))
