"""The keys of conf/campaign.yaml, checked; the comments there explain them."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.settings import STRICT

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, config=STRICT)
class Places:
    """Procedural scenes.  first: number of the first location.  width, height: pixels a frame."""

    first: Annotated[int, Field(ge=0)]
    locations: Count
    frames: Count
    width: Annotated[int, Field(ge=64, le=4096)] = 968
    height: Annotated[int, Field(ge=48, le=4096)] = 608

    @property
    def numbers(self) -> range:
        """The numbers of the locations."""
        return range(self.first, self.first + self.locations)


@dataclass(frozen=True, config=STRICT)
class DataSettings:
    """Keys of `data`."""

    words: tuple[str, ...]
    train: Places
    sparse: Places | None
    wide: Places | None
    test: Places
    checks: Places
    variants: Count
    pack: Literal["exact", "small"] | None
    flsea: str | None
    mdd: str | None

    def __post_init__(self) -> None:
        chosen = [places for places in (self.train, self.sparse, self.wide) if places]
        learned = {number for places in chosen for number in places.numbers}
        for name in ("test", "checks"):
            if learned & set(getattr(self, name).numbers):
                raise ValueError(
                    f"{name} shares locations with what is learned from; give it other numbers"
                )


@dataclass(frozen=True, config=STRICT)
class RowSettings:
    """One entry of `rows`.

    words: of `simnfnd train`.  cpu_s: budget of each training, or steps: its length.
    checks: validations, if not as many as the others have.
    places: whose renders it learns from; with data=self_supervised whose noisy pictures.
    start: the row whose weights it begins from.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]
    words: tuple[str, ...]
    cpu_s: Annotated[float, Field(gt=0)] | None = None
    steps: Count | None = None
    checks: Count | None = None
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (0,)
    data: Literal["simnfnd", "olddata", "self_supervised"] = "simnfnd"
    places: Literal["train", "sparse", "wide"] = "train"
    start: str | None = None

    def __post_init__(self) -> None:
        if (self.cpu_s is None) == (self.steps is None):
            raise ValueError(f"{self.name}: give it cpu_s or steps, one of them")


@dataclass(frozen=True, config=STRICT)
class CampaignSettings:
    """The whole configuration."""

    out: str
    only: tuple[str, ...]
    show: bool
    debug: bool
    threads: Count
    jobs: Count
    checks: Count
    pace_steps: Count
    data: DataSettings
    words: tuple[str, ...]
    baselines: tuple[str, ...]
    evaluation: tuple[str, ...]
    rows: tuple[RowSettings, ...]

    def __post_init__(self) -> None:
        known: dict[str, RowSettings] = {}
        seeds: set[tuple[str, int]] = set()
        for row in self.rows:
            recipe = replace(row, seeds=(0,))
            if known.setdefault(row.name, recipe) != recipe:
                raise ValueError(f"rows: {row.name} is there twice with other words or budget")
            if row.places != "train" and getattr(self.data, row.places) is None:
                raise ValueError(f"rows: {row.name} needs data.{row.places}")
            for seed in row.seeds:
                if (row.name, seed) in seeds:
                    raise ValueError(f"rows: {row.name} has seed {seed} twice")
                seeds.add((row.name, seed))
        for row in self.rows:
            self.depth(row)

    def depth(self, row: RowSettings) -> int:
        """How many trainings come before those of a row."""
        depth, known = 0, {one.name: one for one in self.rows}
        while row.start is not None:
            depth += 1
            if row.start not in known or depth > len(known):
                raise ValueError(f"rows: {row.name}: start must name a row that comes to an end")
            row = known[row.start]
        return depth
