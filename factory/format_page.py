"""docs/dataset.md, written from the schema.

`python -m simnfnd.factory.format_page > docs/dataset.md` makes it anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from .dataset.describe import format_texts as texts
from .dataset.format.layers import (
    ECHO_FIELDS,
    ECHO_FOLDER,
    OPTIONAL_LAYERS,
    Layer,
    layers,
    stores_grey,
)
from .dataset.format.schema import ROOT_ATTRIBUTES, SCHEMA, VALUE_RANGES
from .labels import CLASSES
from .noise.registry import NoiseSettings
from .sample_table.record import columns, requested

_HEAD = f"""\
# The dataset format `{SCHEMA}`

*Written from `factory/dataset/format/schema.py` and `layers.py` by
`python -m simnfnd.factory.format_page`; change it there.*

```text
<dataset>/
  manifest.json          which shards belong to it, samples, bytes and SHA-256 of each
  index.h5               all shards as one file, by virtual datasets with relative paths
  train/shard-00000.h5   the samples
  test/shard-00000.h5
  config.yaml            every setting of the run
  failed.jsonl           frames that gave no sample, why, and the command that tries them again
  README.md, preview.png
  extended.json          of a dataset that was extended: the samples of the shards it began with
```

While a run goes on, manifest.jsonl beside manifest.json has the shards that were finished since
manifest.json was written last; the project's own readers take it in, and it is gone at the end.

A scene is in train or in test, never in both. The folder can be moved. Every file is HDF5 that
any library since 1.10 reads; the pictures are compressed as `dataset.compression` says (`gzip` and
`none` need nothing, `lzf` needs h5py, `zstd` needs the hdf5plugin package) and carry a Fletcher-32
checksum (all but `none`), which HDF5 compares; the project's own readers compare one of every
picture, table and text, so that a damaged one is an error and not a wrong picture.
"""


def markdown() -> str:
    """The whole text of docs/dataset.md."""
    always, optional = layers("uint8"), [one for one in OPTIONAL_LAYERS if not one.of_camera]
    effect = layers("uint8", ["layers/background"])[-1]
    kinds = ", ".join(
        f"{name} ({low:g} no echo, {high:g} full scale)"
        for name, (low, high) in VALUE_RANGES.items()
    )
    parts = [
        _HEAD,
        "## Pictures\n",
        "(samples, rows, columns), one chunk a picture. Grey values are of one type in a dataset, "
        f"as `dataset.dtype` says: {kinds}.\n",
        _table(("layer", "type", "units", "what it is"), [_row(layer) for layer in always]),
        "On request (`dataset.layers=[effects,range,segmentation,...]`; segmentation, which brings "
        "instance, for procedural scenes alone; intensity_db and field with `acoustics=field`). "
        "A point of the cloud is range, azimuth and elevation of a bin (in sonar axes "
        "x = r cos e cos a ahead, y = -r cos e sin a to the left, z = r sin e up), its strength "
        "intensity_db; `examples/point_cloud.py` writes one:\n",
        _table(
            ("layer", "type", "units", "what it is"),
            [
                (
                    "`/layers/<effect>`",
                    *_row(effect)[1:3],
                    "noisy image with that effect as its only noise, for each effect that is on",
                ),
                *(_row(layer) for layer in optional),
            ],
        ),
        texts.CAMERA,
        _table(
            ("layer", "type", "units", "dimensions", "what it is"),
            [
                (*_row(one)[:3], ", ".join(one.of_camera), one.description)
                for one in OPTIONAL_LAYERS
                if one.of_camera
            ],
        ),
        "Classes of `/segmentation` (0 to 11 are those of the Marine Debris Dataset): "
        + ", ".join(f"{number} {name}" for number, name in enumerate(CLASSES))
        + ".\n",
        "Dimensions carry scales (`/axes/...`, with `units` and `description`): range and azimuth "
        "of polar pictures, ahead and right of fan pictures; in metres where all pictures have "
        "one range window, otherwise relative, and `range_min_m`, `range_max_m`, "
        "`metres_per_pixel` of `/meta` turn them into metres.\n",
        texts.ECHOES,
        _table(
            ("field", "type", "units", "what it is"),
            [_row(one, ECHO_FOLDER) for one in ECHO_FIELDS],
        ),
        "## `/meta`\n",
        "One row a sample. A parameter of an effect that is off is NaN or empty. With "
        "`acoustics=field` there is one more column `noise.<effect>.<parameter>` for each "
        "parameter of the effects in [physics.md](physics.md). `full_scale` has two units: the "
        "echo level that is shown as grey value 1 by default, and with `acoustics=field` the "
        "intensity over the source level, whose square root is that level.\n",
        _table(
            ("column", "type", "units", "what it is"),
            [
                (f"`{column.name}`", f"`{column.dtype}`", column.units, column.description)
                for column in columns(NoiseSettings())
            ],
        ),
        "On request, `dataset.columns=[pose,intrinsics]`, and `[calibration]` with "
        "`acoustics=field`; NaN where the recording does not say. World axes are the recording's "
        "(z is up in `seabed`), camera axes x right, y down, z forward, sonar axes x forward, y "
        "left, z up:\n",
        _table(
            ("column", "type", "units", "what it is"),
            [
                (f"`{column.name}`", f"`{column.dtype}`", column.units, column.description)
                for column in requested(("pose", "intrinsics", "calibration"))
            ],
        ),
        "## Root attributes\n",
        _table(
            ("attribute", "what it is"),
            [(f"`{name}`", text) for name, text in ROOT_ATTRIBUTES.items()],
        ),
        texts.VALUES,
        texts.CONFIG_HASH,
        texts.CHECKSUMS,
        texts.INDEX,
        texts.READING,
    ]
    return "\n".join(parts)


def _row(layer: Layer, folder: str = "") -> tuple[str, str, str, str]:
    kind = "grey" if stores_grey(layer) else f"`{layer.dtype}`"
    return f"`/{folder}{layer.name}`", kind, layer.units, layer.description


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
