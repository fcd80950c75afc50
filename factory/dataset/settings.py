"""The `dataset` group: where a dataset goes and how its numbers are stored."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..common.settings import STRICT
from .schema import DATASET_NAME, OPTIONAL_LAYERS
from .storage import folder_of, is_url

ColumnName = Literal["pose", "intrinsics", "calibration", "boxes", "visibility", "tracks"]


@dataclass(frozen=True, config=STRICT)
class DatasetSettings:
    """Keys of the `dataset` group.

    dir: the dataset's folder; None is `outputs/<name>-<first 8 digits of the config hash>`.
    name: what the dataset is called.
    dtype: of /noisy and /clean: uint8 (0..255) or float32 (0..1).
    compression: none reads five times as fast as gzip, and takes more room.
    compression_level: of gzip.
    layers: more images for each sample: `effects` (the noisy image with one noise effect alone,
        for each), `static` (the clean image without moving objects), `mean` (what the mean of noisy
        images shows; of acoustics=coherent), and what lies behind a
        pixel: range, azimuth, elevation, elevation_min, elevation_max, valid_azimuth,
        segmentation (of procedural scenes; brings instance); of acoustics=coherent also
        what was received: intensity_db and field (complex); and what the camera saw: rgb and
        depth, in the frame's own size.
    columns: more columns of /meta: pose (of camera and sonar, tilt, altitude, time), intrinsics
        (of the camera), calibration (source level, absorption, time-varying gain; of
        acoustics=coherent), boxes (JSON: of each object its box in 3-D and in range and
        bearing, and how much of it the sound reaches), visibility (JSON: of each object by how
        much its echoes stand out, dB; needs the layer segmentation), tracks (JSON: of each moving
        object its number, place, velocity, box and target strength).
    max_train, max_test: upper limits on samples; None takes what there is.
    preview_pairs: pairs on the contact sheet preview.png; 0 draws none.
    licence: of the dataset, as the user decides; stated in the dataset card.
    """

    dir: str | None = None
    name: str = "dataset"
    dtype: Literal["uint8", "float32"] = "uint8"
    compression: Literal["gzip", "none"] = "gzip"
    compression_level: Annotated[int, Field(ge=0, le=9)] = 1
    layers: tuple[str, ...] = ()
    columns: tuple[ColumnName, ...] = ()
    max_train: Annotated[int, Field(ge=0)] | None = None
    max_test: Annotated[int, Field(ge=0)] | None = None
    preview_pairs: Annotated[int, Field(ge=0, le=64)] = 8
    licence: str | None = None

    def __post_init__(self) -> None:
        if not DATASET_NAME.fullmatch(self.name):
            raise ValueError(
                f"name {self.name!r} must be letters, digits, dot, dash and underscore"
            )
        # The layer instance comes with segmentation and is not asked for by itself.
        known = {"effects", *(layer.name for layer in OPTIONAL_LAYERS)} - {"instance"}
        if unknown := sorted(set(self.layers) - known):
            raise ValueError(f"layers: {unknown[0]} is none of {', '.join(sorted(known))}")
        for key, names in (("layers", self.layers), ("columns", self.columns)):
            if len(set(names)) != len(names):
                raise ValueError(f"{key} {list(names)} names one twice")

    def directory(self, config_hash: str, part: str = "") -> Path:
        """The folder that this dataset goes to, or the local copy of the URL.

        part: of a run that makes a slice.  Raises FactoryError for a URL that is none.
        """
        if self.dir is not None and is_url(self.dir):
            return folder_of(self.dir, part)
        return Path(self.dir or Path("outputs") / f"{self.name}-{config_hash[:8]}").expanduser()

    @property
    def limits(self) -> dict[str, int | None]:
        """Split -> upper limit on its samples."""
        return {"train": self.max_train, "test": self.max_test}
