"""The keys of conf/evaluation.yaml, real.yaml and realism.yaml, checked; see the comments there."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..factory.settings import STRICT

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, config=STRICT)
class DatasetFolder:
    """The dataset to read: the folder that `simnfnd make` wrote."""

    dir: str


@dataclass(frozen=True, config=STRICT)
class TuningSettings:
    """Keys of `tuning`."""

    auto: bool
    file: str | None
    validation: Annotated[float, Field(gt=0, lt=1)]
    pairs: Count


@dataclass(frozen=True, config=STRICT)
class AblationSettings:
    """Keys of `ablation`: the weights of the paper's Table 3."""

    olddata_l1: str | None
    simnfnd_l1: str | None
    simnfnd_newloss: str | None


@dataclass(frozen=True, config=STRICT)
class PicturesFolder:
    """An entry of `pictures`: the row's name, and the folder of its denoised pictures."""

    name: Annotated[str, Field(min_length=1)]
    dir: Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, config=STRICT)
class PageSettings:
    """Keys of `page`."""

    examples: Annotated[int, Field(ge=0)]
    methods: Count


@dataclass(frozen=True, config=STRICT)
class ReportSettings:
    """Keys that both reports on methods have."""

    out: str | None
    workers: Literal["auto"] | Count
    bootstrap: Annotated[int, Field(ge=100)]
    seed: Annotated[int, Field(ge=0)]
    image_timeout_s: Annotated[float, Field(gt=0)]
    baselines: list[str]
    device: Literal["auto", "cpu", "gpu"]
    debug: bool


@dataclass(frozen=True, config=STRICT)
class EvaluationSettings(ReportSettings):
    """All keys of conf/evaluation.yaml."""

    dataset: DatasetFolder
    split: Literal["train", "test", "all"]
    limit: Count | None
    shadow_threshold: Annotated[float, Field(ge=0, lt=1)]
    models: Literal["auto"] | list[str]
    pictures: list[PicturesFolder]
    ablation: AblationSettings
    texture: bool
    page: PageSettings
    tuning: TuningSettings

    @property
    def name(self) -> str:
        """Of the dataset: its folder's."""
        return Path(self.dataset.dir).resolve().name

    @property
    def folder(self) -> Path:
        """Where the report goes."""
        return Path(self.out or Path("outputs", "evaluation", f"{self.name}-{self.split}"))

    @property
    def tuned_file(self) -> Path:
        """Where the tuned parameters are kept."""
        default = Path("outputs", "evaluation", f"{self.name}-tuned.json")
        return Path(self.tuning.file) if self.tuning.file is not None else default


@dataclass(frozen=True, config=STRICT)
class RealSettings(ReportSettings):
    """All keys of conf/real.yaml."""

    real: Annotated[str, Field(min_length=1)]
    models: list[str]
    groups: bool
    limit: Annotated[int, Field(ge=4)] | None
    in_time: Annotated[int, Field(ge=0)]
    examples: Annotated[int, Field(ge=0)]

    @property
    def name(self) -> str:
        """Of what is judged."""
        return Path(self.real).expanduser().resolve().name

    @property
    def folder(self) -> Path:
        """Where the report goes."""
        return Path(self.out or Path("outputs", "evaluation", f"{self.name}-real"))


@dataclass(frozen=True, config=STRICT)
class Grid:
    """The common polar grid of `realism` and `fit`: bins over the range, beams over the sector.

    All widths along range and bearing are in cells of this grid: both sides must be on the same.
    """

    range_bins: Annotated[int, Field(ge=64, le=4096)] = 440
    beams: Annotated[int, Field(ge=32, le=2048)] = 128


@dataclass(frozen=True, config=STRICT)
class RealismSettings:
    """All keys of conf/realism.yaml."""

    real: Annotated[str, Field(min_length=1)]
    sim: Annotated[tuple[str, ...], Field(min_length=1)]
    sim_split: Literal["train", "test", "all"] = "all"
    layer: Literal["noisy", "clean"] = "noisy"
    limit: Annotated[int, Field(ge=4)] | None = None
    grid: Grid = field(default_factory=Grid)
    seed: Annotated[int, Field(ge=0)] = 0
    out: str | None = None
    debug: bool = False
