"""Shards through a network: /noisy becomes /denoised of a file of the same name."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py

from ...factory.dataset.reader import ImageStack, check_in_isolation, open_shard, value_range
from ...factory.errors import FactoryError, FrameError
from ...factory.files import write_atomically
from ...factory.sonar.geometry import FanGeometry, recorded_sonar
from .files import Job
from .inputs import Item
from .pictures import Denoising, Picture
from .writers import COMPARED, write_compared

SCHEMA = "simnfnd-denoised/1"


def denoise_shard(item: Item, job: Job) -> None:
    """Denoise /noisy of a shard into /denoised of a file of its name; /meta and /axes go along.

    Raises FrameError when it is not a shard of this program, or damaged.
    """
    # Made in memory and written in one go, like the shards themselves.
    with (
        opened_shard(item.source) as source,
        h5py.File("denoised.h5", "w", driver="core", backing_store=False) as target,
    ):
        of_points = made_of_points(source)
        denoise = job.points() if of_points else job.denoise
        noisy, clean = ImageStack(source["noisy"]), ImageStack(source["clean"])
        form, full = source["noisy"], value_range(source)
        job.bar.total += len(noisy)
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
        denoising, geometry = Denoising(denoise), _geometry_of(source)
        for row in range(len(noisy)):
            try:
                image = noisy[row]
                denoised[row] = denoising.one(image, partial(geometry, row))
                if row < COMPARED:
                    shown.append([one / full for one in (image, denoised[row], clean[row])])
            except FactoryError as error:
                raise FrameError(f"{item.source}: {error}") from error
            job.bar.update()
        target.flush()
        content = target.id.get_file_image()
    path = job.out / item.relative
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)
    if job.compare and shown:
        write_compared(job.out / item.compared, shown)
    job.done(item, denoise.name, of_points=of_points)


def opened_shard(path: Path) -> h5py.File:
    """The shard, opened, by another process first.

    Raises FrameError when it is not a shard of this program, or damaged.
    """
    try:
        check_in_isolation([path])
        return open_shard(path)
    except FactoryError as error:
        raise FrameError(str(error)) from error


def made_of_points(shard: h5py.File) -> bool:
    """Whether the pictures of a shard have the paper's noise: acoustics.formation=points."""
    try:
        config = json.loads(shard.attrs["config"])
        return config.get("devices") is None and "acoustics" not in config
    except (KeyError, TypeError, ValueError):
        return False


def _geometry_of(shard: h5py.File) -> Callable[[int, Picture], FanGeometry | None]:
    """Row and its picture -> where range and bearing are, if the shard says so."""
    try:
        sonar = recorded_sonar(json.loads(shard.attrs["config"]))
        if sonar is not None:
            FanGeometry.from_record(sonar, shard["meta"][0])
    except (KeyError, TypeError, ValueError, IndexError):
        sonar = None
    if sonar is None:
        return lambda row, _: None
    return lambda row, _: FanGeometry.from_record(sonar, shard["meta"][row])
