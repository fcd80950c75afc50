"""A light pair source for tests of shards and scheduler: little fans, and frames that misbehave."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simnfnd.factory.common.array_types import Bools, Float32s
from simnfnd.factory.common.errors import FactoryError, FrameError, NotRendered
from simnfnd.factory.common.seeds import stream
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.schema import Axis, Column, Pair, Prepared


@dataclass(frozen=True)
class FakeConfig:
    """What the fake makes, and which frames (by name) go wrong in which way.

    killed_once, late: names that die the first time, or wait, leaving a mark in `marks`.
    prepared: folder in which a FakePreparer leaves a file a frame; empty: nothing is prepared.
    """

    shape: tuple[int, int] = (24, 20)
    bad: tuple[str, ...] = ()
    buggy: tuple[str, ...] = ()
    fatal: tuple[str, ...] = ()
    kills: tuple[str, ...] = ()
    killed_once: tuple[str, ...] = ()
    hangs: tuple[str, ...] = ()
    stops: tuple[str, ...] = ()
    delay_s: float = 0.0
    marks: str = ""
    prepared: str = ""


def refs(count: int, scene: str = "alpha", location: str = "reef") -> list[FrameRef]:
    """`count` frames of one scene."""
    return [FrameRef(location, scene, f"{number:04d}") for number in range(count)]


def rerun(ref: FrameRef) -> str:
    """A command line for failed.jsonl."""
    return f"simnfnd make frames.only=[{ref.name}]"


class FakeSource:
    """`dataset.schema.PairSource` that draws a seeded fan with a bright arc and its shadow."""

    def __init__(self, config: FakeConfig) -> None:
        self.config = config

    def axes(self) -> tuple[Axis, Axis]:
        """Ahead and right, metres."""
        height, width = self.config.shape
        return (
            Axis("ahead", "m", 8.0 - (np.arange(height) + 0.5) * 8 / height, "from the sonar"),
            Axis("right", "m", (np.arange(width) + 0.5 - width / 2) * 8 / height),
        )

    def columns(self) -> tuple[Column, ...]:
        """One of every kind."""
        return (
            Column("location", "S16"),
            Column("scene", "S16"),
            Column("frame", "S16"),
            Column("variant", "i4"),
            Column("noise.background.density", "f8", "1", "fraction of the scene points"),
            Column("points.scene", "i8", "1"),
        )

    def pairs(self, ref: FrameRef, variants: tuple[int, ...]) -> list[Pair]:
        """The asked variants, unless the frame is one of those that misbehave."""
        if not self.ready(ref):
            raise NotRendered(ref.name)
        misbehave(self.config, ref.name)
        time.sleep(self.config.delay_s)
        return [self._pair(ref, variant) for variant in variants]

    def ready(self, ref: FrameRef) -> bool:
        """Whether its file is there."""
        return not self.config.prepared or prepared_file(self.config, ref).exists()

    def set_cache_keys(self, keys: Mapping[str, str]) -> None:
        """Its frames are found by their names alone."""

    def _pair(self, ref: FrameRef, variant: int) -> Pair:
        rng = stream(0, ref.name, variant)
        clean, shadow = fan(self.config.shape, rng)
        density = float(rng.uniform(0.1, 0.5))
        speckle = rng.exponential(density, clean.shape).astype(np.float32)
        noisy = np.where(clean > 0, np.clip(clean * (1 - density) + speckle, 0, 1), 0)
        return Pair(
            noisy=np.rint(noisy * 255).astype(np.uint8),
            clean=np.rint(clean * 255).astype(np.uint8),
            shadow=shadow,
            record={
                "location": ref.location,
                "scene": ref.scene,
                "frame": ref.frame,
                "variant": variant,
                "noise.background.density": density,
                "points.scene": int(clean.size),
            },
        )


def prepared_file(config: FakeConfig, ref: FrameRef) -> Path:
    """Where a FakePreparer leaves its mark."""
    return Path(config.prepared) / ref.name.replace("/", "-")


class FakePreparer:
    """`sample.Preparer`: the frames misbehave here, so that the source need not."""

    def __init__(self, config: FakeConfig) -> None:
        self.config = config

    def prepare(self, ref: FrameRef) -> Prepared:
        """Leave a file, unless it is there."""
        file = prepared_file(self.config, ref)
        if file.exists():
            return Prepared(True, 0)
        misbehave(self.config, ref.name)
        time.sleep(self.config.delay_s)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(str(os.getpid()))
        return Prepared(False, 1)


class GentleSource(FakeSource):
    """A source whose frames misbehave only while they are prepared."""

    def __init__(self, config: FakeConfig) -> None:
        super().__init__(FakeConfig(shape=config.shape, prepared=config.prepared))


def misbehave(config: FakeConfig, name: str) -> None:
    """Do what the configuration says of this frame."""
    if name in config.bad:
        raise FrameError(f"{name}: depth has 3 NaN pixels")
    if name in config.buggy:
        raise ZeroDivisionError("no such thing")
    if name in config.fatal:
        raise FactoryError("render.kind=cycles needs bpy")
    if name in config.kills or (name in config.killed_once and _first_time(config, name)):
        os.kill(os.getpid(), signal.SIGKILL)
    if name in config.stops:
        os.kill(os.getpid(), signal.SIGSTOP)
    if name in config.hangs:
        time.sleep(600)


def _first_time(config: FakeConfig, name: str) -> bool:
    mark = Path(config.marks) / name.replace("/", "-")
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


class BrokenSource:
    """A source that cannot be built."""

    def __init__(self, config: Any) -> None:
        raise FactoryError("render.kind=cycles needs bpy; use Python 3.11")


class LethalSource:
    """A source that kills whoever builds it."""

    def __init__(self, config: Any) -> None:
        os._exit(9)


def fan(shape: tuple[int, int], rng: np.random.Generator) -> tuple[Float32s, Bools]:
    """(H, W) float32 image in [0, 1] of a 60 degree fan, and its shadows."""
    height, width = shape
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    ahead = 1.02 - rows / height
    right = (columns - width / 2 + 0.5) / height
    range_ = np.hypot(ahead, right)
    azimuth = np.arctan2(right, ahead)
    inside = (np.abs(azimuth) < np.deg2rad(30)) & (range_ > 0.1) & (range_ < 1.0)
    floor = 0.25 + 0.1 * np.sin(60 * range_ + 8 * azimuth + rng.uniform(0, 6))
    shadow = np.zeros(shape, dtype=bool)
    image = floor
    for _ in range(5):
        at = rng.uniform(0.25, 0.8)
        bearing = rng.uniform(-0.4, 0.4)
        width_rad = rng.uniform(0.03, 0.1)
        length = rng.uniform(0.08, 0.25)
        beam = np.abs(azimuth - bearing) < width_rad
        shadow |= beam & (range_ > at) & (range_ < at + length)
        bright = np.exp(-(((range_ - at) / 0.012) ** 2)) * beam
        image = np.maximum(image, bright)
    shadow &= inside
    image = np.where(inside & ~shadow, np.clip(image, 0, 1), 0)
    return image.astype(np.float32), shadow
