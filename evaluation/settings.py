"""The keys of conf/evaluation.yaml, checked; the comments there explain them."""

from __future__ import annotations

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
class EvaluationSettings:
    """All keys."""

    dataset: DatasetFolder
    split: Literal["train", "test", "all"]
    out: str | None
    workers: Literal["auto"] | Count
    limit: Count | None
    shadow_threshold: Annotated[float, Field(ge=0, lt=1)]
    bootstrap: Annotated[int, Field(ge=100)]
    seed: Annotated[int, Field(ge=0)]
    image_timeout_s: Annotated[float, Field(gt=0)]
    baselines: list[str]
    models: Literal["auto"] | list[str]
    pictures: list[PicturesFolder]
    ablation: AblationSettings
    device: Literal["auto", "cpu", "gpu"]
    texture: bool
    robustness: list[str]
    real: list[str]
    page: PageSettings
    tuning: TuningSettings
    debug: bool

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
