"""Keys of `simnfnd evaluate realism`."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.settings import STRICT
from .polar import Grid


@dataclass(frozen=True, config=STRICT)
class RealismSettings:
    """What is compared, and how often.

    real: folder of real pictures.  sim: datasets of the factory, or further folders of pictures.
    sim_split: part of each dataset to use.  layer: noisy or clean pictures.
    limit: at most so many pictures of each, evenly spread; null uses all.
    grid: the polar grid on which everything is measured.
    resamples: how often the real pictures are halved anew and as many simulated ones drawn.
    halves: random, or blocks of neighbours in the order of the file names (recordings are
        sequences, so neighbours look alike: halves of blocks differ more).
    out: folder of the report; null = outputs/realism/<first dataset>.
    """

    real: Annotated[str, Field(min_length=1)]
    sim: Annotated[tuple[str, ...], Field(min_length=1)]
    sim_split: Literal["train", "test", "all"] = "all"
    layer: Literal["noisy", "clean"] = "noisy"
    limit: Annotated[int, Field(ge=4)] | None = None
    grid: Grid = field(default_factory=Grid)
    resamples: Annotated[int, Field(ge=2, le=10000)] = 200
    halves: Literal["random", "blocks"] = "random"
    seed: Annotated[int, Field(ge=0)] = 0
    out: str | None = None
    debug: bool = False
