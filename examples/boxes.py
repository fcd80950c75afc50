"""Boxes of the objects in sonar images, for a detector.

simnfnd make experiment=physical render=embree scenes.locations=1 dataset.dir=outputs/boxes \
    dataset.layers=[segmentation]
python examples/boxes.py outputs/boxes

`simnfnd export outputs/boxes --to coco` (or `--to yolo`) writes them for training; this is how to
get them from the masks, box by box.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

LEAST_PX = 8

if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
shards = sorted(folder.glob("*/shard-*.h5"))
if not shards:
    sys.exit(f"{folder}: no shards below it; give the folder of a dataset")
for path in shards:
    with h5py.File(path) as shard:
        if "instance" not in shard:
            sys.exit(f"{folder} has no labels; make it as the first lines say")
        classes = list(shard["segmentation"].attrs["classes"])
        for number, row in enumerate(shard["meta"]):
            labels = shard["segmentation"][number]
            instance = shard["instance"][number]
            for thing in np.unique(instance[instance > 0]):
                rows, columns = np.nonzero(instance == thing)
                if len(rows) < LEAST_PX:
                    continue
                name = classes[np.bincount(labels[rows, columns]).argmax()]
                box = f"{columns.min()},{rows.min()} {np.ptp(columns) + 1}x{np.ptp(rows) + 1}"
                print(f"{row['scene'].decode()}/{row['frame'].decode()}: {name} {thing} {box}")
