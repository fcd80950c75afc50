"""The keys of conf/models.yaml, checked; the comments there explain them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from factory.settings import STRICT, union_tags

Count = Annotated[int, Field(ge=1)]
Fraction = Annotated[float, Field(gt=0, lt=1)]

union_tags("literal['auto']", "constrained-int")


@dataclass(frozen=True, config=STRICT)
class DatasetFolder:
    """The dataset to learn from: the folder that `python -m factory` wrote."""

    dir: str


@dataclass(frozen=True, config=STRICT)
class DataSettings:
    """Keys of `data`: what the network gets to see."""

    patch: Annotated[int, Field(ge=8)]
    batch: Count
    flip: bool
    validation: Fraction
    validation_limit: Count | None
    workers: Literal["auto"] | Annotated[int, Field(ge=0)]


@dataclass(frozen=True, config=STRICT)
class TrainSettings:
    """Keys of `train`: how the weights are found."""

    steps: Count
    check_every: Count
    learning_rate: Annotated[float, Field(gt=0)]
    weight_decay: Annotated[float, Field(ge=0)]
    warmup: Annotated[int, Field(ge=0)]
    clip: Annotated[float, Field(gt=0)]
    ema: Annotated[float, Field(ge=0, lt=1)]
    precision: Literal["32-true", "bf16-mixed", "16-mixed"]

    def __post_init__(self) -> None:
        if self.steps % self.check_every:
            raise ValueError(
                f"steps {self.steps} must be a multiple of check_every {self.check_every}, "
                "so that training ends with a validation"
            )


@dataclass(frozen=True, config=STRICT)
class ModelsSettings:
    """The whole configuration; `model` and `loss` are checked by what they describe."""

    dataset: DatasetFolder
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    out: str | None
    resume: bool
    seed: Annotated[int, Field(ge=0)]
    device: Literal["auto", "cpu", "gpu"]
    debug: bool
    data: DataSettings
    train: TrainSettings
    model: Mapping[str, Any]
    loss: Mapping[str, Any]
