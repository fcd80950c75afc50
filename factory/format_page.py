"""docs/dataset.md, written from the schema.

`python -m simnfnd.factory.format_page > docs/dataset.md` makes it anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from simnfnd.factory.dataset.format.layers import OPTIONAL_LAYERS, Layer, layers, stores_grey
from simnfnd.factory.dataset.format.schema import ROOT_ATTRIBUTES, SCHEMA, VALUE_RANGES
from simnfnd.factory.labels import CLASSES
from simnfnd.factory.meta.record import columns, requested
from simnfnd.factory.noise.registry import NoiseSettings

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

_VALUES = """\
`value_meaning` says that noisy and clean have the same scale. That holds by default, and with
`acoustics=field` for `acoustics.target=mean_field`. The targets `geometry` and `radiometric` are
other quantities than an echo level: their clean picture is scaled by a full scale of its own
(`clean_full_scale`), so its grey values can be compared within a picture and not with noisy.
"""

_CONFIG_HASH = """\
## The config hash

Anybody can compute it again from a shard:

```python
import hashlib, h5py

with h5py.File("outputs/demo/train/shard-00000.h5") as shard:
    text = shard.attrs["config"].encode()
    print(hashlib.blake2b(text, digest_size=8).hexdigest(), shard.attrs["config_hash"])
```

`config` holds what decides the samples: every setting but the folders, the name, licence and
preview of the dataset, the number of workers and the cache, and for the default `acoustics` what
only `acoustics=field` uses; and `frames_found`, a hash of the names of the frames. config.yaml has
all settings, so its hash is another one. In manifest.json and index.h5 of an extended dataset
`config` also has the list `extends`, which is not hashed; the list `merged` of a merged one is.
"""

_CHECKSUMS = """\
## Checksums

`/checksums` has a row a sample and a column a layer: the CRC-32 of the picture's bytes. Anybody can
compare it:

```python
import h5py, zlib

with h5py.File("outputs/demo/train/shard-00000.h5") as shard:
    for layer in shard["checksums"].dtype.names:
        for number, image in enumerate(shard[layer]):
            assert zlib.crc32(image.tobytes()) == shard["checksums"][layer][number]
```

The root attributes `checksum` (of the other root attributes, /meta, the axes and /checksums) and
`text_checksum` (of units, descriptions and what else layers, columns and axes state) are BLAKE2b,
digests of 16 bytes, of a JSON text that `factory/dataset/format/checksums.py` writes; the project's
readers compare them. They tell of damage, not of malice: who changes a file can write them anew.
Shards of earlier versions have none of the three and are read all the same.
"""

_INDEX = """\
## index.h5

`/train/...` and `/test/...` hold the layers and `/meta` of all shards, one after another in the
order of their names; `/axes` and the root attributes are those of the shards. HDF5 fills a shard
that is missing with zeros and says nothing: check manifest.json first, as
`examples/read_with_h5py.py` does.
"""

_READING = """\
## Reading

With h5py alone:

```python
import h5py

with h5py.File("outputs/demo/index.h5") as index:
    noisy, clean = index["train/noisy"][0], index["train/clean"][0]
```

With the reader, which checks manifest and files first, works in the worker processes of a torch
DataLoader and gives floats on request:

```python
from simnfnd import PairDataset

with PairDataset("outputs/demo", "train", scaled=True) as pairs:
    sample = pairs[0]  # {"noisy": (H, W) float32 in 0..1, "clean": ...}
    batch = pairs[0:3]  # the same with (3, H, W)
    print(len(pairs), pairs.shape, pairs.value_range, pairs.axes[0].units, pairs.meta()[0]["scene"])
```

`pairs.Pairs` is the same as a torch `Dataset` of tensors. `examples/` holds scripts that
train and that load with several processes.

MATLAB reads the shards (gzip or none) with its own functions, dimensions reversed:

```text
noisy = h5read('outputs/demo/train/shard-00000.h5', '/noisy', [1 1 1], [Inf Inf 1])';
clean = h5read('outputs/demo/train/shard-00000.h5', '/clean', [1 1 1], [Inf Inf 1])';
meta  = h5read('outputs/demo/train/shard-00000.h5', '/meta');
imshowpair(noisy, clean, 'montage'); disp(meta.scene(:, 1)')
```

Julia with HDF5.jl, dimensions reversed likewise:

```text
using HDF5
h5open("outputs/demo/train/shard-00000.h5") do shard
    noisy = permutedims(shard["noisy"][:, :, 1])
    clean = permutedims(shard["clean"][:, :, 1])
    println(size(noisy), " ", read_attribute(shard, "schema"))
end
```

## More of it

```text
simnfnd make ... dataset.dir=DIR frames.variants=2 dataset.on_existing=extend
```

adds to the dataset in DIR what the new configuration has more: frames, scenes, variants, higher
`dataset.max_train` and `max_test`, a download that has grown. The shards that are there stay as
they are, to the byte; the new ones come after them and state the new configuration's hash, which
each shard's entry of manifest.json has (`config_hash`), while `extends` in the manifest's `config`
lists the earlier ones. Every sample is the one that a new dataset of the same configuration would
have; only which shard it lies in differs, and, where a limit bites, which frames were taken.

Any other key that differs is refused by name, and so are fewer variants, a lower limit, a frame
that would be left out, and a scene that would change from train to test (with `split.test_fraction`
new scenes may do that: name those that test with `split.test`). An extension that was interrupted
goes on with the same command, or without `on_existing`. Frames that failed before are tried again.
`simnfnd plan ... dataset.on_existing=extend` shows what would be added. Other noise or
another sonar is another dataset: give it a folder of its own; a sweep names one for each point.

## Is it whole

```text
simnfnd validate DIR          # manifest, SHA-256, schema, counts, leaks, double samples
simnfnd validate DIR --deep   # and every picture: NaN, ranges, checksums, equal pictures
```

prints what is wrong; the exit code is 0, or 1 when anything is. A file that was damaged, or made to
do harm, can make the HDF5 library crash or never return. So `validate`, `export`, `inspect`,
`preview`, `evaluate`, `denoise` and `PairDataset` open every shard in a process of its own first;
`PairDataset(..., trusted=True)` leaves that out. Refused are links, virtual datasets and external
data that lead out of a shard, a split that is not the folder's, attributes that are absent or no
text, and a table of chunks that is not one chunk for each picture at a place of its own, filtered
as the layer says.

A flipped bit in a picture, a table or an attribute is an error for these readers, whatever the
compression; how many of how many, and what HDF5 alone would have shown, is in
[trust.md](trust.md). `PairDataset(..., verify="hash")` compares the SHA-256 of each shard with
manifest.json, too, once when it is opened for the first time: for shards of versions before the
checksums, of which /meta, /axes and plain pictures have none.
"""

_CAMERA = """\
`dataset.layers=[rgb,depth]` stores the RGBD frame that the pair was made of, as the reader gives it
(undistorted where `scenes.undistort` says so), in its own size, (samples, rows, columns) of the
camera and without axes; `dataset.columns=[intrinsics]` has its focal lengths, principal point and
distortion. All frames of a dataset have one size: one of another size than the first goes to
failed.jsonl and is named there. Renders keep neither colour nor the whole depth, so frames are read
once more (0.02 CPU seconds for one of FLSea, 0.35 for a procedural one of 968x608), also from a
cache of renders; a pack has none. A pair grows by 3 MB (968x608, gzip). Who stores `rgb` or `depth`
of a recording stores that recording, under its terms: FLSea's, for one, may not be passed on.
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
        _CAMERA,
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
        "of polar pictures, ahead and right of fan pictures; in metres where the range window is "
        "fixed, otherwise relative, and `range_min_m`, `range_max_m`, `metres_per_pixel` of "
        "`/meta` turn them into metres.\n",
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
        _VALUES,
        _CONFIG_HASH,
        _CHECKSUMS,
        _INDEX,
        _READING,
    ]
    return "\n".join(parts)


def _row(layer: Layer) -> tuple[str, str, str, str]:
    kind = "grey" if stores_grey(layer) else f"`{layer.dtype}`"
    return f"`/{layer.name}`", kind, layer.units, layer.description


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
