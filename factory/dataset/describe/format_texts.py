"""Texts of docs/dataset.md, which `simnfnd.factory.format_page` puts together."""

CAMERA = """\
`dataset.layers=[rgb,depth]` stores the RGBD frame that the pair was made of, as the reader gives it
(undistorted where `scenes.undistort` says so), in its own size, (samples, rows, columns) of the
camera and without axes; `dataset.columns=[intrinsics]` has its focal lengths, principal point and
distortion. All frames of a dataset have one size: one of another size than the first goes to
failed.jsonl and is named there. Renders keep neither colour nor the whole depth, so frames are read
once more (0.02 CPU seconds for one of FLSea, 0.35 for a procedural one of 968x608), also from a
cache of renders; a pack has none. A pair grows by 3 MB (968x608, gzip). Who stores `rgb` or `depth`
of a recording stores that recording, under its terms: FLSea's, for one, may not be passed on.
"""

VALUES = """\
`value_meaning` says that noisy and clean have the same scale. That holds by default, and with
`acoustics=field` for `acoustics.target=mean_field`. The targets `geometry` and `radiometric` are
other quantities than an echo level: their clean picture is scaled by a full scale of its own
(`clean_full_scale`), so its grey values can be compared within a picture and not with noisy.
"""

CONFIG_HASH = """\
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

CHECKSUMS = """\
## Checksums

`/checksums` has a row a sample and a column a layer: the CRC-32 of the picture's bytes (and a
column a field of /echoes, of the bytes of the sample's values). Anybody can compare it:

```python
import h5py, zlib

with h5py.File("outputs/demo/train/shard-00000.h5") as shard:
    for layer in shard["checksums"].dtype.names:
        for number, image in enumerate(shard[layer]):  # of echoes/...: shard[layer][first:end]
            assert zlib.crc32(image.tobytes()) == shard["checksums"][layer][number]
```

The root attributes `checksum` (of the other root attributes, /meta, the axes and /checksums) and
`text_checksum` (of units, descriptions and what else layers, columns and axes state) are BLAKE2b,
digests of 16 bytes, of a JSON text that `factory/dataset/format/checksums.py` writes; the project's
readers compare them. They tell of damage, not of malice: who changes a file can write them anew.
Shards of earlier versions have none of the three and are read all the same.
"""

INDEX = """\
## index.h5

`/train/...` and `/test/...` hold the layers and `/meta` of all shards, one after another in the
order of their names; `/axes` and the root attributes are those of the shards. HDF5 fills a shard
that is missing with zeros and says nothing: check manifest.json first, as
`examples/read_with_h5py.py` does.
"""

READING = """\
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

ECHOES = """\
## `/echoes`

A picture tells of the strongest echo of each bin; `dataset.layers=[echoes]` stores all of them: the
insonified surface points in the window, one for each pixel of the camera that the sonar hears, at
full density (resampling then keeps `resample.rate` of them in the pictures). One flat array a
field, uncompressed; `/echoes/place` (samples, 2) int64 has the first echo of every sample and the
one after its last, and samples of one frame that differ in noise alone share a list. Within a
sample bins ascend, so all echoes of a bin are one slice:

```text
first, end = shard["echoes/place"][sample]
rows, beams = shard["echoes/bin"].attrs["grid"]
low, high = np.searchsorted(shard["echoes/bin"][first:end], [bin, bin + 1])
elevations = shard["echoes/elevation"][first + low : first + high]
```

Range bins and beams are rows and columns of a polar picture; a fan is drawn from them. With the
reader, `echoes = pairs.echoes(7)` and `echoes["elevation"][echoes.in_bin(120, 40)]`;
`examples/bin_echoes.py` shows one bin. A list takes 27 bytes an echo, 11 to 15 MB for a frame of
968x608, and all lists of a shard are in memory while it is written: lower `scheduler.shard_size`
for large frames. Lists are not in index.h5 and not in exports. With `acoustics=field` the echoes
are the same points, before beam pattern, absorption and pulse; what was received is `intensity_db`.
"""
