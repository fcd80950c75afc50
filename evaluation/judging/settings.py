"""The keys of the configurations of `simnfnd evaluate`, checked; comments stand in conf/*.yaml."""

from __future__ import annotations

import math
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from ...factory.common.files import real_path
from ...factory.common.limits import limited
from ...factory.common.settings import STRICT

Count = Annotated[int, Field(ge=1, le=10_000_000)]
# Each draw takes a number for every image in memory.
Draws = Annotated[int, Field(ge=100, le=100_000)]
Shown = Annotated[int, Field(ge=0, le=10_000)]
Seconds = Annotated[float, limited(0.001, 86_400, "s")]
Pixels = Annotated[float, limited(0.01, 4096, "px")]
Pair = tuple[Pixels, Pixels]


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
class ImagesFolder:
    """An entry of `pictures`: the row's name, and the folder of its denoised images."""

    name: Annotated[str, Field(min_length=1)]
    dir: Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, config=STRICT)
class ReportSettings:
    """Keys that both reports on methods have."""

    out: str | None
    workers: Literal["auto"] | Count
    bootstrap: Draws
    seed: Annotated[int, Field(ge=0)]
    image_timeout_s: Seconds
    baselines: list[str]
    examples: Shown
    device: Literal["auto", "cpu", "gpu"]
    debug: bool


@dataclass(frozen=True, config=STRICT)
class EvaluationSettings(ReportSettings):
    """All keys of conf/evaluation.yaml."""

    dataset: DatasetFolder
    split: Literal["train", "test", "all"]
    limit: Count | None
    models: Literal["auto"] | list[str]
    pictures: list[ImagesFolder]
    ablation: dict[Literal["olddata_l1", "simnfnd_l1", "simnfnd_newloss"], str | None]
    tuning: TuningSettings

    @property
    def name(self) -> str:
        """Name of the dataset: that of its folder."""
        return real_path(Path(self.dataset.dir)).name

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
    pictures: list[ImagesFolder]
    groups: bool
    limit: Annotated[int, Field(ge=4, le=10_000_000)] | None
    in_time: Shown

    @property
    def name(self) -> str:
        """Name of what is judged."""
        return real_path(Path(self.real).expanduser()).name

    @property
    def folder(self) -> Path:
        """Where the report goes."""
        return Path(self.out or Path("outputs", "evaluation", f"{self.name}-real"))


@dataclass(frozen=True, config=STRICT)
class TargetsSettings(ReportSettings):
    """All keys of conf/targets.yaml."""

    recordings: Annotated[list[str], Field(min_length=1)]
    models: list[str]
    frames: list[Annotated[int, Field(ge=1, le=10_000)]]
    fixed: list[dict[str, dict[str, int | float]]]
    sizes: Annotated[list[Pair], Field(min_length=1)]
    contrasts: Annotated[list[Annotated[float, Field(gt=0, le=1000)]], Field(min_length=1)]
    speed_px: Pair
    tracks: Count
    repeats: Count
    track_frames: Annotated[int, Field(ge=2, le=100_000)]
    limit: Annotated[int, Field(ge=20, le=10_000_000)]

    @property
    def folder(self) -> Path:
        """Where the report goes."""
        name = real_path(Path(self.recordings[0]).expanduser()).name
        return Path(self.out or Path("outputs", "evaluation", f"{name}-targets"))


ArmName = Literal["blob", "simulation", "real", "both"]


@dataclass(frozen=True, config=STRICT)
class OptionalDatasetFolder:
    """A dataset to read, or none."""

    dir: str | None


@dataclass(frozen=True, config=STRICT)
class TransferReportSettings:
    """All keys of conf/transfer.yaml."""

    real: str | None
    dataset: OptionalDatasetFolder
    classes: list[str] | None
    annotations: str | None
    detector: str | None
    ignore: list[str]
    class_names: dict[str, str] | None
    padding: Annotated[float, Field(ge=0, le=0.2)]
    margin: Annotated[float, Field(ge=-0.2, le=0.2)]
    with_shadow: list[str]
    min_visibility: Annotated[float, Field(ge=-100, le=100)] | None
    min_side: Annotated[float, Field(ge=0, le=0.2)]
    far_end: bool
    clutter: bool
    arms: Annotated[list[ArmName], Field(min_length=1)]
    shares: Annotated[list[Annotated[float, Field(gt=0, le=1)]], Field(min_length=1)]
    folds: Annotated[int, Field(ge=2, le=20)]
    steps: Count
    real_steps: Count
    batch: Annotated[int, Field(ge=2, le=10_000)]
    learning_rate: Annotated[float, Field(gt=0, le=10)]
    limit: Annotated[int, Field(ge=4, le=10_000_000)] | None
    quick: bool
    examples: Shown
    seed: Annotated[int, Field(ge=0)]
    bootstrap: Annotated[int, Field(ge=20, le=100_000)]
    out: str | None
    debug: bool

    @property
    def name(self) -> str:
        """Name of the real images, or of the dataset where there are none."""
        return real_path(Path(self.real or self.dataset.dir or "dataset").expanduser()).name

    @property
    def folder(self) -> Path:
        """Where the report and the detectors go."""
        kind = "transfer-quick" if self.quick else "transfer"
        return Path(self.out or Path("outputs", kind, self.name)).expanduser()

    def quickened(self) -> Self:
        """The same comparison, small enough for five minutes."""
        if not self.quick:
            return self
        return replace(
            self,
            folds=2,
            steps=min(self.steps, 100),
            real_steps=min(self.real_steps, 20),
            limit=min(self.limit or 200, 200),
            bootstrap=min(self.bootstrap, 100),
        )


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
    limit: Annotated[int, Field(ge=4, le=10_000_000)] | None = None
    grid: Grid = field(default_factory=Grid)
    seed: Annotated[int, Field(ge=0)] = 0
    out: str | None = None
    debug: bool = False


# What decides the renders, the frames or where things lie: not for a search over noise.
_FIXED = (
    "scenes", "render", "sonar.mount", "frames", "split", "seed", "dataset", "scheduler", "cache",
    "shard", "debug",
)  # fmt: skip


@dataclass(frozen=True, config=STRICT)
class SearchedKey:
    """What is searched for one key of the factory's configuration.

    low, high: limits of its value.  log: search the logarithm.  choices: instead of limits, the
    values to choose from.  spread: a number, or [low, high] to search it as well; above 0 the
    value is drawn for each sample, uniform from v - spread * (high - low) to v + spread * (high -
    low) within the limits, or from v / (1 + spread) to v * (1 + spread) with log.
    """

    low: float | None = None
    high: float | None = None
    log: bool = False
    choices: tuple[float | int | str | bool, ...] | None = None
    spread: float | tuple[float, float] = 0.0

    @model_validator(mode="after")
    def _whole(self) -> Self:
        low, high = self.limits
        least, most = self.spreads
        if self.choices is not None:
            if not self.choices or not math.isnan(low + high) or most:
                raise ValueError("choices: at least one, and neither low, high nor spread beside")
        elif not low < high or (self.log and low <= 0):
            raise ValueError("give choices, or low < high; log needs low > 0")
        elif not 0 <= least <= most:
            raise ValueError("spread must be a number from 0, or [low, high] with 0 <= low <= high")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the value; NaN where there are none."""
        low, high = (math.nan if end is None else end for end in (self.low, self.high))
        return low, high

    @property
    def spreads(self) -> tuple[float, float]:
        """Limits of the spread; equal ones when it is not searched."""
        return self.spread if isinstance(self.spread, tuple) else (self.spread, self.spread)


@dataclass(frozen=True, config=STRICT)
class FitSettings:
    """Keys of `simnfnd evaluate fit`, as conf/fit.yaml explains them."""

    real: Annotated[str, Field(min_length=1)]
    parameters: dict[str, SearchedKey]
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")] = "fitted"
    recipe: tuple[str, ...] = ("experiment=physical",)
    frames: Annotated[int, Field(ge=8, le=100_000)] = 24
    grid: Grid = field(default_factory=Grid)
    trials: Count = 200
    startup: Count = 40
    seed: Annotated[int, Field(ge=0)] = 0
    out: str | None = None
    debug: bool = False

    @field_validator("parameters", mode="before")
    @classmethod
    def _flat(cls, tree: dict[str, Any]) -> dict[str, Any]:
        """The values without the keys that are set to null."""
        return {key: value for key, value in flattened(tree).items() if value is not None}

    @model_validator(mode="after")
    def _searchable(self) -> Self:
        if not self.parameters:
            raise ValueError("parameters: name at least one key to search")
        for key in self.parameters:
            if f"{key}.".startswith(tuple(f"{fixed}." for fixed in _FIXED)):
                raise ValueError(
                    f"parameters.{key}: it decides what is rendered or where it goes, and cannot "
                    "be searched; set it in recipe"
                )
        return self

    @property
    def folder(self) -> Path:
        """Where the search and its result go."""
        return Path(self.out or Path("outputs", "fit", self.name))


_WORDS = {"low", "high", "log", "choices", "spread"}


def flattened(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested keys as dotted ones, as YAML and the command line may give either."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and not _WORDS & set(value):
            flat |= flattened(value, f"{name}.")
        else:
            flat[name] = value
    return flat
