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

if not (folder / "manifest.json").is_file():
    sys.exit(f"{folder}: no manifest.json in it; give the folder of a dataset")
listed = json.loads((folder / "manifest.json").read_text())["shards"]
shards = [shard for shard in listed if shard["split"] == "train"]
if not shards:
    sys.exit(f"{folder}: all of its pairs test; this reads those that train")
ends = np.cumsum([shard["samples"] for shard in shards])

# One shard is open at a time: a dataset may have more than the system lets a process open.
squares = []
for number in np.sort(rng.integers(ends[-1], size=count)):
    place = np.searchsorted(ends, number, side="right")
    row = number - ends[place] + shards[place]["samples"]
    with h5py.File(folder / shards[place]["path"]) as shard:
        full = shard.attrs["value_range"][1]
        difference = shard["noisy"][row] / full - shard["clean"][row] / full
        frame = shard["meta"][row]
    squares.append(np.mean(difference**2))
print(f"{count} random reads of {ends[-1]} pairs in {len(shards)} shards")
print(f"mean PSNR {np.mean(-10 * np.log10(np.maximum(squares, 1e-10))):.2f} dB")
print(f"the last one shows {frame['scene'].decode()}, frame {frame['frame'].decode()}")

# index.h5 holds the pairs of small datasets once more, and links to the shards of large ones.
with h5py.File(folder / "index.h5") as index:
    if "noisy" in index["train"]:
        print(f"index.h5 joins them: {index['train/noisy'].shape}")
    else:
        print(f"index.h5 links to them: {len(index['train'])} shards")
