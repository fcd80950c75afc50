"""Denoising of datasets: /noisy of each shard becomes /denoised of a file of its name.

Frames of a recording are denoised in time, also where it lies in several shards.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.files import write_atomically
from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from ..recordings.inputs import InputFile
from .images import Denoised
from .job import DenoisingJob
from .records import FrameRecord
from .reports import FileReport, frame_row
from .temporal.stream import SequenceFrame
from .writers import COMPARED, Compared, write_compared

if TYPE_CHECKING:
    import h5py

SCHEMA = "simnfnd-denoised/1"


class _Sample(NamedTuple):
    """A row of a shard."""

    shard: _Shard
    row: int


class _Images(NamedTuple):
    """A row with its images, as stored."""

    sample: _Sample
    noisy: Array
    clean: Array


class _Shard:
    """A shard, and the results of its rows, in memory until all are there."""

    def __init__(self, item: InputFile) -> None:
        """Raises FrameError when it is no shard of this program, or damaged."""
        from ...factory.dataset.layout import config_of

        self.item = item
        with opened_shard(item.source) as source:
            self.table = source["meta"][()]
            self.config = config_of(source)
        self.of_points = made_of_points(self.config)
        self.sonar = recorded_sonar(self.config)
        self.rows_left = len(self.table)
        self.shown: list[Compared] = []
        self.report = FileReport(str(item.relative))
        self._source: h5py.File | None = None
        self._denoised: Array | None = None

    def images(self, row: int) -> tuple[Array, Array]:
        """Noisy and clean as stored.  Raises FactoryError for a damaged one."""
        from ...factory.dataset.reader import ImageStack

        source = self._opened()
        return ImageStack(source["noisy"])[row], ImageStack(source["clean"])[row]

    def full_scale(self) -> float:
        """The grey value of full scale."""
        from ...factory.dataset.reader import value_range

        return value_range(self._opened())

    def place(self, row: int, _: Array) -> FanGeometry | None:
        """Where range and bearing are in an image."""
        if self.sonar is None:
            return None
        return FanGeometry.from_record(self.sonar, self.table[row])

    def put(self, row: int, image: Array) -> None:
        """Keep the result of a row."""
        if self._denoised is None:
            noisy = self._opened()["noisy"]
            self._denoised = np.empty(noisy.shape, noisy.dtype)
        self._denoised[row] = image
        self.rows_left -= 1

    def content(self, digest: str) -> bytes:
        """The file of the results, with /meta and /axes of the shard.  digest: of the weights."""
        import h5py  # for datasets alone

        assert self._denoised is not None
        source = self._opened()
        # Made in memory and written in one go, like the shards themselves.
        with h5py.File("denoised.h5", "w", driver="core", backing_store=False) as results:
            results.attrs["schema"] = SCHEMA
            results.attrs["config_hash"] = source.attrs["config_hash"]
            results.attrs["weights_sha256"] = digest
            for name in ("meta", "axes"):
                if name in source:
                    source.copy(name, results)
            stack = results.create_dataset(
                "denoised",
                shape=self._denoised.shape,
                dtype=self._denoised.dtype,
                chunks=(1, *self._denoised.shape[1:]),
                compression="gzip",
                compression_opts=1,
                fletcher32=True,
                track_times=False,
            )
            for row, image in enumerate(self._denoised):
                stack[row] = image
            results.flush()
            return bytes(results.id.get_file_image())

    def close(self) -> None:
        """Close the file and the results."""
        if self._source is not None:
            self._source.close()
        self._source = None
        self._denoised = None

    def _opened(self) -> h5py.File:
        if self._source is None:
            from ...factory.dataset.reader import open_shard

            self._source = open_shard(self.item.source)
        return self._source


def denoise_shards(items: Sequence[InputFile], job: DenoisingJob) -> None:
    """Denoise one shard, or all shards of a dataset of recordings.

    A recording with a frame that cannot be denoised fails with all shards that it lies in.
    """
    shards = []
    for item in items:
        try:
            shards.append(_Shard(item))
        except FrameError as error:
            job.failures.append(str(error))
    # Shards, by their `id`, whose results are written or will not be.
    finished = {id(shard) for shard in shards if shard.item in job.journal}
    job.bar.total += sum(shard.rows_left for shard in shards if id(shard) not in finished)
    for sequence in _sequences(shards):
        owners = {id(sample.shard): sample.shard for sample in sequence}
        if set(owners) <= finished:
            continue
        try:
            _denoise_sequence(sequence, finished, job)
        except FrameError as error:
            job.failures.append(str(error))
            # Their results would have gaps.
            finished |= set(owners)
        for key, shard in owners.items():
            if not shard.rows_left and key not in finished:
                _write(shard, job)
                finished.add(key)
            if key in finished:
                shard.close()


def _sequences(shards: Sequence[_Shard]) -> Iterator[list[_Sample]]:
    """Frames of a recording in the order of time; other samples alone."""
    from ...factory.dataset.recordings import is_of_recordings

    recordings: dict[tuple[Any, ...], list[_Sample]] = {}
    for shard in shards:
        is_recording = is_of_recordings(shard.config)
        for row, record in enumerate(shard.table):
            sample = _Sample(shard, row)
            if is_recording:
                key = tuple(record[name] for name in ("location", "scene", "variant"))
                recordings.setdefault(key, []).append(sample)
            else:
                yield [sample]
    for samples in recordings.values():
        yield sorted(samples, key=lambda sample: sample.shard.table[sample.row]["frame"])


def _denoise_sequence(samples: Sequence[_Sample], finished: set[int], job: DenoisingJob) -> None:
    """Denoise samples and keep the results of those whose shards are not finished.

    Raises FrameError for one that cannot be denoised.
    """
    first = samples[0].shard
    network = job.points() if first.of_points else job.denoise
    denoising = job.means.denoising.of_simulated(network)

    def shot_of(number: int, sample: _Sample) -> SequenceFrame:
        shard = sample.shard
        wanted = id(shard) not in finished
        place = partial(shard.place, sample.row)
        try:
            images = _Images(sample, *shard.images(sample.row))
            return denoising.shot(images, images.noisy, place, number=number, wanted=wanted)
        except (FactoryError, LookupError, ValueError) as error:
            raise FrameError(f"{shard.item.source}: {error}") from error

    shots = starmap(shot_of, enumerate(samples))
    for denoised in denoising.sequence(shots, alone=len(samples) == 1):
        if id(denoised.key.sample.shard) not in finished:
            _keep(denoised, job)


def _keep(denoised: Denoised, job: DenoisingJob) -> None:
    (shard, row), noisy, clean = denoised.key
    shard.put(row, denoised.image)
    record = FrameRecord.of(noisy, denoised)
    shard.report.add(f"pair {row}", record)
    job.frame_rows.append(frame_row(shard.report.name, row, None, record.facts))
    full = shard.full_scale()
    if job.video is not None:
        job.video.add(noisy / full, denoised.image / full)
    if job.compare and row < COMPARED:
        panels = noisy / full, denoised.image / full, denoised.removed.shown()
        shard.shown.append(Compared(*panels, clean=clean / full, label=f"pair {row}"))
    job.bar.update()


def _write(shard: _Shard, job: DenoisingJob) -> None:
    path = job.out / shard.item.relative
    path.parent.mkdir(parents=True, exist_ok=True)
    network = job.points() if shard.of_points else job.denoise
    write_atomically(path, shard.content(network.digest))
    if shard.shown:
        write_compared(job.out / shard.item.compared, shard.shown)
    job.done(shard.item, shard.report, network.name, of_points=shard.of_points)


def opened_shard(path: Path) -> h5py.File:
    """The shard, opened, by another process first.

    Raises FrameError when it is not a shard of this program, or damaged.
    """
    from ...factory.dataset import reader

    try:
        reader.check_in_isolation([path])
        return reader.open_shard(path)
    except FactoryError as error:
        raise FrameError(str(error)) from error


def made_of_points(config: Mapping[str, Any]) -> bool:
    """Whether images have the paper's noise: acoustics=pointwise.  config: as a shard states it."""
    from ...factory.dataset.meaning import formation_of

    return formation_of(config) == "pointwise"
