"""Shards through a network: /noisy becomes /denoised of a file of the same name."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import h5py

from ...factory.dataset.reader import ImageStack, check_in_isolation, open_shard, value_range
from ...factory.errors import FactoryError, FrameError
from ...factory.files import write_atomically
from ...factory.sonar.geometry import FanGeometry, recorded_sonar
from .denoiser import Denoiser
from .files import Job
from .inputs import Item
from .pictures import denoise_image
from .writers import COMPARED, write_compared

SCHEMA = "simnfnd-denoised/1"


def denoise_shard(item: Item, job: Job, denoise: Denoiser) -> None:
    """Denoise /noisy of a shard into /denoised of a file of its name; /meta and /axes go along.

    Raises FrameError when it is not a shard of this program, or damaged.
    """
    try:
        source = opened_shard(item)
    except FactoryError as error:
        raise FrameError(str(error)) from error
    # Made in memory and written in one go, like the shards themselves.
    with (
        source,
        h5py.File("denoised.h5", "w", driver="core", backing_store=False) as target,
    ):
        noisy, clean = ImageStack(source["noisy"]), ImageStack(source["clean"])
        form, full = source["noisy"], value_range(source)
        target.attrs["schema"] = SCHEMA
        target.attrs["config_hash"] = source.attrs["config_hash"]
        target.attrs["weights_sha256"] = denoise.digest
        for name in ("meta", "axes"):
            if name in source:
                source.copy(name, target)
        denoised = target.create_dataset(
            "denoised",
            shape=form.shape,
            dtype=form.dtype,
            chunks=(1, *form.shape[1:]),
            compression="gzip",
            compression_opts=1,
            fletcher32=True,
            track_times=False,
        )
        shown = []
        geometry = _geometry_of(source)
        for row in range(len(noisy)):
            try:
                image = noisy[row]
                truth = clean[row] if row < COMPARED else None
                denoised[row] = denoise_image(image, denoise, geometry(row))
            except FactoryError as error:
                raise FrameError(f"{item.source}: {error}") from error
            if truth is not None:
                shown.append(tuple(x / full for x in (image, denoised[row], truth)))
            job.tick()
        target.flush()
        content = target.id.get_file_image()
    path = job.out / item.relative
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)
    if job.compare and shown:
        write_compared(job.out / item.compared, shown)


def opened_shard(item: Item) -> h5py.File:
    """The shard, opened; one that nobody has looked at is opened by another process first.

    Raises FactoryError when it is not a shard of this program, or damaged.
    """
    if not item.checked:
        found = item.source.stat() if item.source.exists() else None
        _look_at(item.source, found and found.st_mtime_ns)
    return open_shard(item.source)


@lru_cache(maxsize=4096)
def _look_at(path: Path, changed_ns: int | None) -> None:
    check_in_isolation([path])


def made_of_points(item: Item) -> bool:
    """Whether the pictures of a shard have the paper's noise: acoustics.formation=points.

    Raises FrameError when it is not a shard of this program, or damaged.
    """
    try:
        with opened_shard(item) as shard:
            config = json.loads(shard.attrs["config"])
            return config.get("devices") is None and "acoustics" not in config
    except (KeyError, TypeError, ValueError):
        return False
    except FactoryError as error:
        raise FrameError(str(error)) from error


def _geometry_of(shard: h5py.File) -> Callable[[int], FanGeometry | None]:
    """Row -> where range and bearing are, if the shard says so."""
    try:
        sonar = recorded_sonar(json.loads(shard.attrs["config"]))
        if sonar is None:
            return lambda row: None
        FanGeometry.from_record(sonar, shard["meta"][0])
    except (KeyError, TypeError, ValueError, IndexError):
        return lambda row: None
    return lambda row: FanGeometry.from_record(sonar, shard["meta"][row])
