"""The keys of conf/models.yaml, checked; the comments there explain them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..factory.common.settings import STRICT

Count = Annotated[int, Field(ge=1, le=100_000_000)]
Share = Annotated[float, Field(ge=0, le=1)]
ScaleFactor = Annotated[float, Field(gt=0, le=16)]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class DataSettings:
    """Keys of `data` that every kind has: what the network gets to see."""

    kind: str
    patch: Annotated[int, Field(ge=8, le=8192)]
    batch: Count
    crops: Count
    weaker: Share
    displays: Share = 0.0
    radial: Share = 0.0
    validation: Annotated[float, Field(gt=0, lt=1)]
    validation_limit: Count | None
    reuse: Annotated[int, Field(ge=1, le=1000)]
    workers: Literal["auto"] | Annotated[int, Field(ge=0, le=1024)]

    @property
    def least_side(self) -> int:
        """Pixels that every image must have.

        Crops of several images have one shape; of a single one that of the image will do.
        """
        return self.patch if self.batch > self.crops else 1

    def __post_init__(self) -> None:
        if self.batch % self.crops:
            raise ValueError(
                f"batch: {self.batch} crops per step must be a multiple of crops {self.crops}, "
                "the number that each image gives"
            )


@dataclass(frozen=True, config=STRICT, kw_only=True)
class PairsData(DataSettings):
    """`data=pairs`: the pairs of a dataset as they are."""

    kind: Literal["pairs"]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class RenderedData(DataSettings):
    """What is made of the renders of a dataset at every visit."""

    make: tuple[str, ...]
    pack: str | None
    fewer: Share
    scales: Annotated[
        tuple[ScaleFactor | tuple[ScaleFactor, ScaleFactor], ...], Field(min_length=1)
    ]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class RendersData(RenderedData):
    """`data=renders`: fresh noise."""

    kind: Literal["renders"]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class MixedData(RenderedData):
    """`data=mixed`: drawn devices, the paper's points and recordings beside each other."""

    kind: Literal["mixed"]
    experiment: str
    recordings: tuple[str, ...]
    recordings_share: Share
    points_share: Share
    several: Share
    targets: Share
    water: Share

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.points_share + self.recordings_share > 1:
            raise ValueError("points_share and recordings_share: must not be more than 1 together")


@dataclass(frozen=True, config=STRICT, kw_only=True)
class SequencesData(DataSettings):
    """`data=sequences`: windows of a dataset of recordings."""

    kind: Literal["sequences"]
    frames: Annotated[int, Field(ge=1, le=99)]
    reference: Literal["standing", "clean"]
    targets: Share


@dataclass(frozen=True, config=STRICT, kw_only=True)
class OldData(DataSettings):
    """`data=olddata`: real images taken as clean, artificial noise on top."""

    kind: Literal["olddata"]
    folder: str
    geometry: str


@dataclass(frozen=True, config=STRICT)
class TrainSettings:
    """Keys of `train`: how the weights are found."""

    steps: Count
    check_every: Count
    learning_rate: Annotated[float, Field(gt=0, le=10)]
    weight_decay: Annotated[float, Field(ge=0, le=10)]
    warmup: Annotated[int, Field(ge=0, le=100_000_000)]
    clip: Annotated[float, Field(gt=0, le=1e6)]
    ema: Annotated[float, Field(ge=0, lt=1)]
    precision: Literal["auto", "32-true", "bf16-mixed"]

    def __post_init__(self) -> None:
        """A training that is shorter than the interval is checked at its end."""
        if self.steps < self.check_every:
            object.__setattr__(self, "check_every", self.steps)


@dataclass(frozen=True, config=STRICT)
class ModelsSettings:
    """The whole configuration; `model` and `loss` are checked by what they describe."""

    dataset: Mapping[Literal["dir"], str | None]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    out: str | None
    resume: bool
    start: str | None
    seed: Annotated[int, Field(ge=0)]
    device: Literal["auto", "cpu", "gpu"]
    debug: bool
    data: Annotated[
        PairsData | RendersData | MixedData | SequencesData | OldData, Field(discriminator="kind")
    ]
    train: TrainSettings
    model: Mapping[str, Any]
    loss: Mapping[str, Any]
