"""Read random pairs of a dataset with numpy and h5py alone.

python examples/read_with_h5py.py outputs/demo [PAIRS]
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
count = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
rng = np.random.default_rng(0)

# One file shows all shards.  HDF5 fills a missing shard with zeros and says nothing: look first.
for name in ("manifest.json", "index.h5"):
    if not (folder / name).is_file():
        sys.exit(f"{folder}: no {name} in it; give the folder of a dataset")
listed = json.loads((folder / "manifest.json").read_text())["shards"]
missing = [shard["path"] for shard in listed if not (folder / shard["path"]).is_file()]
if missing:
    sys.exit(f"these shards are missing: {', '.join(missing)}")

with h5py.File(folder / "index.h5") as index:
    if not len(index["train/meta"]):
        sys.exit(f"{folder}: all of its pairs test; this reads those that train")
    noisy, clean, meta = (index[f"train/{name}"] for name in ("noisy", "clean", "meta"))
    full = index.attrs["value_range"][1]
    squares = []
    for number in rng.integers(len(noisy), size=count):
        difference = noisy[number] / full - clean[number] / full
        squares.append(np.mean(difference**2))
    print(
        f"index.h5: {count} random reads of {len(noisy)} pairs, {noisy.shape[1]} x {noisy.shape[2]}"
    )
    print(f"mean PSNR {np.mean(-10 * np.log10(np.maximum(squares, 1e-10))):.2f} dB")
    print(f"the first one shows {meta[0]['scene'].decode()}, frame {meta[0]['frame'].decode()}")

# The same from the shards themselves.
shards = [h5py.File(path) for path in sorted(folder.glob("train/shard-*.h5"))]
for _ in range(count):
    shard = shards[rng.integers(len(shards))]
    row = rng.integers(len(shard["noisy"]))
    if not shard["noisy"][row].any() or not shard["clean"][row].any():
        sys.exit(f"{shard.filename}: sample {row} is empty")
print(f"shards: {count} random reads of {len(shards)} files")
