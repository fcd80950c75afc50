"""Keys of `simnfnd evaluate downstream`; the comments in conf/downstream.yaml explain them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.settings import STRICT
from ..settings import Count

Percent = Annotated[float, Field(gt=0, le=100)]


@dataclass(frozen=True, config=STRICT)
class DownstreamSettings:
    """All keys."""

    real: Annotated[str, Field(min_length=1)]
    baselines: list[str]
    models: list[str]
    sim: str | None
    labels: Annotated[list[Percent], Field(min_length=1)]
    seeds: Count
    folds: Annotated[int, Field(ge=2)]
    split: Literal["components", "pictures"]
    alike: Annotated[float, Field(gt=0, lt=1)]
    shrink: Count
    steps: Count
    batch: Count
    bootstrap: Annotated[int, Field(ge=100)]
    device: Literal["auto", "cpu", "gpu"]
    seed: Annotated[int, Field(ge=0)]
    out: str | None
    debug: bool

    @property
    def folder(self) -> Path:
        """Where the tables go."""
        name = Path(self.real).expanduser().resolve().name
        return Path(self.out or Path("outputs", "evaluation", f"{name}-downstream"))
