"""Keys of `simnfnd evaluate real`; the comments in conf/real.yaml explain them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.settings import STRICT
from ..settings import Count


@dataclass(frozen=True, config=STRICT)
class RealSettings:
    """All keys."""

    real: Annotated[str, Field(min_length=1)]
    baselines: list[str]
    models: list[str]
    tuned: str | None
    groups: Literal["auto"] | bool
    search: Count
    limit: Count | None
    frames: Annotated[int, Field(ge=2)]
    in_time: Annotated[int, Field(ge=0)]
    examples: Annotated[int, Field(ge=0)]
    workers: Literal["auto"] | Count
    device: Literal["auto", "cpu", "gpu"]
    image_timeout_s: Annotated[float, Field(gt=0)]
    seed: Annotated[int, Field(ge=0)]
    bootstrap: Annotated[int, Field(ge=100)]
    out: str | None
    debug: bool

    @property
    def folder(self) -> Path:
        """Where the report goes."""
        name = Path(self.real).expanduser().resolve().name
        return Path(self.out or Path("outputs", "evaluation", f"{name}-real"))
