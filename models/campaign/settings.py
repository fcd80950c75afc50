"""The keys of conf/campaign.yaml, checked; the comments there explain them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from factory.settings import STRICT

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, config=STRICT)
class Places:
    """Procedural scenes.  first: number of the first location."""

    first: Annotated[int, Field(ge=0)]
    locations: Count
    frames: Count

    @property
    def numbers(self) -> range:
        """The numbers of the locations."""
        return range(self.first, self.first + self.locations)


@dataclass(frozen=True, config=STRICT)
class DataSettings:
    """Keys of `data`."""

    words: tuple[str, ...]
    train: Places
    test: Places
    checks: Places
    variants: Count
    pack: Literal["exact", "small"] | None
    flsea: str | None
    mdd: str | None

    def __post_init__(self) -> None:
        for name in ("test", "checks"):
            if set(self.train.numbers) & set(getattr(self, name).numbers):
                raise ValueError(f"train and {name} share locations; give them other numbers")


@dataclass(frozen=True, config=STRICT)
class RowSettings:
    """One entry of `rows`.  words: of `python -m models`.  cpu_s: budget of each training."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]
    words: tuple[str, ...]
    cpu_s: Annotated[float, Field(gt=0)]
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = (0,)
    data: str = "simnfnd"


@dataclass(frozen=True, config=STRICT)
class CampaignSettings:
    """The whole configuration."""

    out: str
    only: tuple[str, ...]
    show: bool
    debug: bool
    threads: Count
    checks: Count
    pace_steps: Count
    data: DataSettings
    words: tuple[str, ...]
    baselines: tuple[str, ...]
    evaluation: tuple[str, ...]
    rows: tuple[RowSettings, ...]

    def __post_init__(self) -> None:
        known: dict[str, tuple[tuple[str, ...], float, str]] = {}
        seen = set()
        for row in self.rows:
            told = (row.words, row.cpu_s, row.data)
            if known.setdefault(row.name, told) != told:
                raise ValueError(f"rows: {row.name} is there twice with other words or budget")
            for seed in row.seeds:
                if (row.name, seed) in seen:
                    raise ValueError(f"rows: {row.name} has seed {seed} twice")
                seen.add((row.name, seed))
            if row.data not in ("simnfnd", "olddata"):
                raise ValueError(f"rows: {row.name}: data must be simnfnd or olddata")
