"""models/pretrained/points.json: which of two kinds of weights suits a picture.

    python -m tools.fit_points FOLDER [PICTURES]

Makes places and pictures of both kinds in FOLDER (what is there is kept), denoises every picture by
`simnfnd` and by `simnfnd-paper`, and fits the small network of
`simnfnd.models.denoise.weighing.points` to which of them gains more; a quarter of the places is
held out.  PICTURES of each kind: 600.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.dataset.describe.quality import psnr_db as picture_psnr_db
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.progress import progress_bar
from simnfnd.factory.render.cache.views import open_views
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.seeds import stream
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.data.any_device import DeviceSource
from simnfnd.models.data.pairs import Source
from simnfnd.models.data.renders import RenderSource
from simnfnd.models.denoise.denoiser import Denoiser, load_denoiser
from simnfnd.models.denoise.weighing.points import FILE, figures, judged, saved, standardised
from simnfnd.models.pretrained import DEFAULT, POINTS
from simnfnd.models.recordings.fan.finder import find_geometry

Floats = npt.NDArray[np.float64]

SEED, PLACES, HELD_OUT, PICTURES = 4, 96, 24, 600
_SCALES = (0.75, 1.0, 1.0, 1.5, 2.0)
_JPEG_SHARE, _QUALITY = 0.15, (75, 96)
_UNTOLD = 0.15
"""Part of the pictures that are judged without geometry, though a fan may be found."""
_HIDDEN, _STEPS, _RATE, _DECAY = 16, 600, 0.02, 0.1
_MOST_DB, _CAUTION = 12.0, 1.5
"""Differences count up to so many dB; harm to a picture of the usual kind counts so much more."""


@dataclass(frozen=True)
class Judged:
    """Figures of pictures (N, F), and PSNR in dB (N, 3): noisy, by DEFAULT, by POINTS."""

    figures: Floats
    psnr_db: Floats

    @property
    def more_db(self) -> Floats:
        """(N,) what POINTS gains more than DEFAULT."""
        return np.asarray(self.psnr_db[:, 2] - self.psnr_db[:, 1])


def main(folder: Path, pictures: int = PICTURES) -> None:
    """Make, judge, fit, write, and print how well it chooses."""
    kinds = {kind: _frames(folder, kind) for kind in ("simnfnd", "any_sonar")}
    both = load_denoiser(DEFAULT, "cpu"), load_denoiser(POINTS, "cpu")
    parts = {
        name: [_judged(source, both, count, f"{kind}, {name}") for kind, source, count in sources]
        for name, sources in {
            "fitted": [(kind, one[0], pictures) for kind, one in kinds.items()],
            "held out": [(kind, one[1], pictures // 4) for kind, one in kinds.items()],
        }.items()
    }
    fitted = Judged(
        np.concatenate([one.figures for one in parts["fitted"]]),
        np.concatenate([one.psnr_db for one in parts["fitted"]]),
    )
    judge = _fit(fitted)
    facts = {"pictures": len(fitted.figures), "places": PLACES - HELD_OUT, "seed": SEED}
    FILE.write_text(saved(judge, facts), encoding="utf-8")
    for kind, found in zip(kinds, parts["held out"], strict=True):
        print(f"{kind}: {_line(found, judge)}")


def _frames(folder: Path, kind: str) -> tuple[Source, Source]:
    """Sources of pictures of a kind: of the places fitted to, and of those held out."""
    words = [
        *(f"experiment={kind}", "render=embree", "scenes=seabed", "scenes.first_location=3000"),
        *(f"scenes.locations={PLACES}", "scenes.frames_per_location=2", "split.test_fraction=0"),
        *(f"cache.dir={folder}/cache", f"dataset.dir={folder}/{kind}", "dataset.preview_pairs=0"),
    ]
    if not (folder / kind / "index.h5").is_file():
        subprocess.run([sys.executable, "-m", "simnfnd.factory", *words], check=True)
    config = compose_config(words)
    views = open_views(config)
    every = tuple(ref for ref in open_reader(config.scenes).discover().frames if views.holds(ref))
    places = sorted({ref.scene for ref in every})
    held = set(places[-HELD_OUT:])

    def source(frames: tuple[FrameRef, ...]) -> Source:
        if kind == "any_sonar":
            return DeviceSource(config, frames, patch=192, weaker=0.1, choices=0, seed=SEED)
        return RenderSource(config, frames, weaker=0.15, fewer=0.2, seed=SEED, scales=_SCALES)

    return (
        source(tuple(ref for ref in every if ref.scene not in held)),
        source(tuple(ref for ref in every if ref.scene in held)),
    )


def _judged(source: Source, both: tuple[Denoiser, Denoiser], count: int, what: str) -> Judged:
    rows, psnr_db = [], []
    with progress_bar(total=count, unit="picture", desc=what) as bar:
        for gray, clean, geometry in _pictures(source, count):
            rows.append(figures(gray, geometry))
            found = (gray, *(denoise(gray, geometry) for denoise in both))
            psnr_db.append([picture_psnr_db(clean, one) for one in found])
            bar.update()
    return Judged(np.array(rows), np.array(psnr_db))


def _pictures(
    source: Source, count: int
) -> Iterator[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], FanGeometry | None]]:
    """Pictures of 8 bits as somebody might give them, with what a look at them says of the fan."""
    for number in range(count):
        rng = stream(SEED, "picture", number)
        sample = source.sample(int(rng.integers(len(source))), number)
        assert sample.clean is not None
        levels = np.rint(sample.noisy * 255).astype(np.uint8)
        if rng.random() < _JPEG_SHARE:
            quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(*_QUALITY))]
            levels = cv2.imdecode(cv2.imencode(".jpg", levels, quality)[1], cv2.IMREAD_GRAYSCALE)
        gray = levels.astype(np.float32) / np.float32(255)
        yield gray, sample.clean, None if rng.random() < _UNTOLD else find_geometry(gray)


def _fit(found: Judged) -> dict[str, Floats]:
    """What `likelihood` needs, by cross entropy weighed by what is at stake."""
    torch.manual_seed(SEED)
    mean, spread = found.figures.mean(0), found.figures.std(0) + 1e-3
    values = standardised(found.figures, {"mean": mean, "spread": spread})
    inputs = torch.tensor(values, dtype=torch.float32)
    wanted = torch.tensor(found.more_db > 0, dtype=torch.float32)
    stake = torch.tensor(np.minimum(np.abs(found.more_db), _MOST_DB), dtype=torch.float32)
    stake = stake * torch.where(wanted > 0, 1.0, _CAUTION)
    first, last = nn.Linear(inputs.shape[1], _HIDDEN), nn.Linear(_HIDDEN, 1)
    network = nn.Sequential(first, nn.Tanh(), last)
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
    cross_entropy = nn.BCEWithLogitsLoss(weight=stake)
    for _ in range(_STEPS):
        optimiser.zero_grad()
        cross_entropy(network(inputs)[:, 0], wanted).backward()
        optimiser.step()
    weights = {
        "first": first.weight,
        "first_bias": first.bias,
        "last": last.weight[0],
        "last_bias": last.bias[0],
    }
    return {
        "mean": mean,
        "spread": spread,
        **{name: value.detach().numpy().astype(np.float64) for name, value in weights.items()},
    }


def _line(found: Judged, judge: dict[str, Floats]) -> str:
    points = judged(found.figures, judge) > 0.5
    noisy, usual, by_points = found.psnr_db.T
    chosen = np.where(points, by_points, usual)
    lost = found.psnr_db[:, 1:].max(1) - chosen
    right = ((found.more_db > 0) == points).mean()
    return (
        f"{len(points)} pictures of places held out: {100 * right:.1f} % right; noisy "
        f"{noisy.mean():.2f} dB, {DEFAULT} {usual.mean():.2f}, {POINTS} {by_points.mean():.2f}, "
        f"chosen {chosen.mean():.2f}, the better of both {(chosen + lost).mean():.2f}; most lost "
        f"in a picture {lost.max():.1f} dB"
    )


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: python -m tools.fit_points FOLDER [PICTURES]")
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
