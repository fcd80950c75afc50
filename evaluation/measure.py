"""Noisy against clean over a whole dataset: the row `Origin` of the paper's Table 2."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import h5py
import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as settings_dataclass
from tqdm import tqdm

from evaluation import metrics
from evaluation.statistics import Estimate, estimate
from factory.errors import FactoryError
from factory.settings import STRICT, union_tags
from factory.shards.reader import open_shard, shard_paths, value_range

# Starting a process costs about as much as measuring this many pairs.
_WORTH_A_PROCESS = 24
_CHUNK = 8

T = TypeVar("T")
R = TypeVar("R")

union_tags("literal['auto']", "constrained-int")


@settings_dataclass(frozen=True, config=STRICT)
class DatasetFolder:
    """The dataset to read: the folder that `python -m factory` wrote."""

    dir: str


@settings_dataclass(frozen=True, config=STRICT)
class EvaluationSettings:
    """Keys of conf/evaluation.yaml, which explains them."""

    dataset: DatasetFolder
    split: Literal["train", "test", "all"]
    out: str | None
    workers: Literal["auto"] | Annotated[int, Field(ge=1)]
    limit: Annotated[int, Field(ge=1)] | None
    shadow_threshold: Annotated[float, Field(ge=0, lt=1)]
    bootstrap: Annotated[int, Field(ge=100)]
    seed: Annotated[int, Field(ge=0)]
    debug: bool


@dataclass(frozen=True)
class Quality:
    """What one pair measures; `_fan` = inside the sonar's sector alone (see `sector_of`)."""

    psnr: float
    ssim: float
    gmsd: float
    psnr_fan: float
    ssim_fan: float
    gmsd_fan: float
    shadow_iou: float
    shadow_residual: float
    false_light_rate: float


METRICS = tuple(item.name for item in fields(Quality))


@dataclass(frozen=True)
class Score:
    """One pair of the dataset and its quality."""

    shard: str
    index: int
    location: str
    scene: str
    frame: str
    variant: int
    quality: Quality

    @property
    def group(self) -> str:
        """What shares one clean image: the unit of the bootstrap."""
        return f"{self.location}/{self.scene}/{self.frame}"


@dataclass(frozen=True)
class _Chunk:
    """Pairs start..stop of one shard; the unit that travels to a process."""

    root: str
    path: str
    start: int
    stop: int
    shadow_threshold: float


def measure(settings: EvaluationSettings) -> list[Score]:
    """Score every pair of the dataset's split, in parallel, in the dataset's order.

    Raises FactoryError for anything that is not a readable dataset.
    """
    chunks = _chunks(settings)
    total = sum(chunk.stop - chunk.start for chunk in chunks)
    if settings.workers == "auto":
        workers = min(os.cpu_count() or 1, max(1, total // _WORTH_A_PROCESS))
    else:
        workers = min(settings.workers, len(chunks))
    scores: list[Score] = []
    with tqdm(total=total, unit="pair", desc="measuring") as bar:
        for part in in_order(_score_chunk, chunks, workers):
            scores.extend(part)
            bar.update(len(part))
    return scores


def summarise(scores: list[Score], settings: EvaluationSettings) -> dict[str, Estimate]:
    """Metric name -> mean with interval; an infinite PSNR counts as metrics.PSNR_CAP_DB."""
    groups = [score.group for score in scores]
    result = {}
    for name in METRICS:
        values = np.array([getattr(score.quality, name) for score in scores], dtype=np.float64)
        if name.startswith("psnr"):
            values = np.minimum(values, metrics.PSNR_CAP_DB)
        result[name] = estimate(values, groups, resamples=settings.bootstrap, seed=settings.seed)
    return result


def sector_of(noisy: metrics.Image, clean: metrics.Image, shadow: metrics.Mask) -> metrics.Mask:
    """(H, W) bool: the pixels where the sonar could have measured anything.

    The shadow mask is confined to the sector, and every other pixel of it carries an echo.
    """
    return np.asarray(shadow | (clean > 0) | (noisy > 0))


def score_pair(
    noisy: metrics.Image,
    clean: metrics.Image,
    shadow: metrics.Mask,
    *,
    data_range: float,
    shadow_threshold: float,
    sector: metrics.Mask | None = None,
) -> Quality:
    """The quality of one noisy image; raises MetricError when there is nothing to compare.

    noisy, clean: (H, W) of one dtype.  shadow: (H, W) bool.  shadow_threshold: fraction of range.
    sector: where the sonar measures; needed for a denoised image, which may bleed out of it.
    """
    if sector is None:
        sector = sector_of(noisy, clean, shadow)
    if not sector.any():
        raise metrics.MetricError("clean, noisy and shadow are empty; nothing to measure")
    similarity = metrics.ssim_map(clean, noisy, data_range=data_range)
    gradients = metrics.gms_map(clean, noisy, data_range=data_range)
    threshold = shadow_threshold * data_range
    return Quality(
        psnr=metrics.psnr(clean, noisy, data_range=data_range),
        ssim=metrics.mean_ssim(similarity),
        gmsd=metrics.deviation(gradients),
        psnr_fan=metrics.psnr(clean, noisy, data_range=data_range, mask=sector),
        ssim_fan=metrics.mean_ssim(similarity, sector),
        gmsd_fan=metrics.deviation(gradients, sector),
        shadow_iou=metrics.shadow_iou(shadow, noisy, threshold=threshold, sector=sector),
        shadow_residual=metrics.shadow_residual(shadow, noisy, data_range=data_range),
        false_light_rate=metrics.false_light_rate(shadow, noisy, threshold=threshold),
    )


def _chunks(settings: EvaluationSettings) -> list[_Chunk]:
    root = Path(settings.dataset.dir)
    chunks, left = [], settings.limit
    for path in shard_paths(root, settings.split):
        with open_shard(path) as file:
            samples = len(file["noisy"])
        if left is not None:
            samples = min(samples, left)
            left -= samples
        chunks += [
            _Chunk(
                str(root),
                str(path),
                start,
                min(start + _CHUNK, samples),
                settings.shadow_threshold,
            )
            for start in range(0, samples, _CHUNK)
        ]
    if not chunks:
        raise FactoryError(f"dataset={root}: its shards hold no samples")
    return chunks


def in_order(work: Callable[[T], R], tasks: Sequence[T], workers: int) -> Iterator[R]:
    """The results of `work` on the tasks, in their order, on so many processes.

    Raises FactoryError when a process dies.
    """
    if workers == 1:
        yield from map(work, tasks)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        try:
            yield from pool.map(work, tasks)
        except BrokenProcessPool as error:
            raise FactoryError(
                "a measuring process died (out of memory?); run again with workers=1"
            ) from error


def _score_chunk(chunk: _Chunk) -> list[Score]:
    path = Path(chunk.path)
    name = path.relative_to(chunk.root).as_posix()
    scores = []
    with open_shard(path) as file:
        data_range = value_range(file)
        for index in range(chunk.start, chunk.stop):
            try:
                images = [file[key][index] for key in ("noisy", "clean", "shadow")]
            except OSError as error:
                raise FactoryError(
                    f"{path}: sample {index} is damaged; generate it again"
                ) from error
            noisy, clean, shadow = images
            try:
                quality = score_pair(
                    noisy,
                    clean,
                    shadow.astype(bool),
                    data_range=data_range,
                    shadow_threshold=chunk.shadow_threshold,
                )
            except metrics.MetricError as error:
                raise FactoryError(f"{path}: sample {index}: {error}") from error
            scores.append(Score(name, index, *identity_of(file, index), quality))
    return scores


def identity_of(file: h5py.File, index: int) -> tuple[str, str, str, int]:
    """(location, scene, frame, variant) of a sample."""
    row = file["meta"][index]
    location, scene, frame = (row[key].decode() for key in ("location", "scene", "frame"))
    return location, scene, frame, int(row["variant"])


def as_rows(scores: list[Score]) -> list[dict[str, object]]:
    """The scores as plain dictionaries, in the order of the CSV's columns."""
    rows = []
    for score in scores:
        row = asdict(score)
        quality = row.pop("quality")
        rows.append({**row, **quality})
    return rows
