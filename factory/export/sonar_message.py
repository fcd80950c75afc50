"""Pings shaped as `marine_acoustic_msgs/ProjectedSonarImage` (ROS): SPLIT/NNNNNN.npz + .json.

The npz holds the arrays of the message: `beam_directions` (beams, 3) float64, unit vectors in the
message's axes (x up, y right, z ahead); `ranges` (bins,) float32, centre of each bin in metres; and
the picture as (bins, beams), whose rows in order are `image.data`: `noisy`, `clean`, `shadow`.  The
JSON holds the other fields under the message's names, then the sample's record.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..dataset.read.source import Sample, Source, json_record
from ..errors import FactoryError
from .notes import write_notes

# SonarImageData.DTYPE_*.
_MESSAGE_DTYPES = {"uint8": 0, "float32": 8}
_HERTZ_PER_KHZ = 1000.0


def write(source: Source, folder: Path) -> str:
    """Fill `folder`.  Raises FactoryError for fan pictures: a ping is ranges x beams."""
    if source.layout != "polar":
        raise FactoryError(
            f"--to sonar_message: {source.directory} holds fan pictures, a ping is ranges x beams; "
            "make it with sonar.image.layout=polar"
        )
    directions = beam_directions(source)
    for split in source.splits:
        (folder / split).mkdir()
        for sample in source.samples(split):
            arrays = {name.replace("/", "_"): image for name, image in sample.images.items()}
            arrays["beam_directions"] = directions
            arrays["ranges"] = ranges_m(source, sample)
            stem = folder / split / f"{sample.number:06d}"
            np.savez_compressed(stem.with_suffix(".npz"), **arrays)
            text = json.dumps(_message(source, sample), indent=1, allow_nan=False)
            stem.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
    write_notes(source, folder, _NOTES)
    return f"{sum(source.splits.values())} pings as npz and JSON"


def beam_directions(source: Source) -> npt.NDArray[np.float64]:
    """(beams, 3) unit vectors: x up, y right, z ahead, as the message defines its axes."""
    _, units, azimuth = source.axes[1]
    azimuth_rad = np.deg2rad(azimuth) if units == "deg" else azimuth
    return np.stack([np.zeros_like(azimuth_rad), np.sin(azimuth_rad), np.cos(azimuth_rad)], axis=1)


def ranges_m(source: Source, sample: Sample) -> npt.NDArray[np.float32]:
    """(bins,) centre of each range bin in metres, in this sample's own window."""
    _, units, values = source.axes[0]
    if units == "1":
        near, far = float(sample.record["range_min_m"]), float(sample.record["range_max_m"])
        values = near + values * (far - near)
    return np.asarray(values, dtype=np.float32)


def _message(source: Source, sample: Sample) -> dict[str, Any]:
    projection, frequency_khz = _sonar(source)
    beams = source.shape[1]
    return {
        # A simulated ping has no time; 0 is ROS's "not set".
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "sonar"},
        "ping_info": {
            "frequency": _HERTZ_PER_KHZ * frequency_khz,
            # Ranges are metres from the start: no sound speed was ever needed (0: unavailable).
            "sound_speed": 0.0,
            "tx_beamwidths": [],
            "rx_beamwidths": [],
        },
        "image": {
            "is_bigendian": False,
            "dtype": _MESSAGE_DTYPES[source.dtype],
            "beam_count": beams,
        },
        "projection": projection,
        "record": json_record(sample.record),
    }


def _sonar(source: Source) -> tuple[str, float]:
    """(projection, frequency in kHz or 0) as the shards' settings say."""
    sonar = source.config.get("sonar", {})
    if isinstance(sonar, dict):
        projection, frequency_khz = (
            sonar.get("projection", "slant_range"),
            sonar.get("frequency_khz", 0.0),
        )
        if isinstance(projection, str) and isinstance(frequency_khz, int | float):
            return projection, float(frequency_khz)
    raise FactoryError(
        f"--to sonar_message: {source.directory}: attribute config has no usable sonar settings; "
        "make the dataset again"
    )


_NOTES = """\
One ping is `SPLIT/NNNNNN.npz` and `SPLIT/NNNNNN.json`; together they hold the fields of
`marine_acoustic_msgs/ProjectedSonarImage` under its names. `ranges` and `beam_directions` (x up, y
right, z ahead) are in the npz; `header`, `ping_info` (Hz; 0 or empty: not known) and `image` in the
JSON. `image.data` is one of the arrays `noisy` and `clean` of the npz, row after row (a row is one
range, near range first, beams from left to right), little-endian: `npz["noisy"].tobytes()`.
`shadow` is true in acoustic shadow. `projection` tells whether a range is slant or horizontal.
"""
