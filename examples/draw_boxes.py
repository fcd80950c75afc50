"""Boxes of the objects on a sonar fan, from the column `boxes`.

python examples/draw_boxes.py outputs/valves valves.png

Draws the images with most objects of a class of your own (a third word: of that class): the box
around the echoes in range and bearing, and the ground of the 3-D box.
"""

import json
import sys
from pathlib import Path

import cv2
import h5py
import numpy as np

if len(sys.argv) < 3:
    sys.exit(__doc__)
folder, out, *wanted = sys.argv[1:]
samples = []
shards = sorted(Path(folder).glob("*/shard-*.h5"))
if not shards:
    sys.exit(f"{folder}: no shards below it; give the folder of a dataset")
for path in shards:
    with h5py.File(path) as shard:
        if "boxes" not in shard["meta"].dtype.names:
            sys.exit(f"{folder} has no boxes; make it with dataset.columns=[boxes]")
        own = wanted or shard["segmentation"].attrs["classes"][21:]
        for number, row in enumerate(shard["meta"]):
            boxes = [box for box in json.loads(row["boxes"]) if box["class"] in own]
            heard = sum(box["insonified"] for box in boxes)
            samples.append((heard, -len(samples), shard["noisy"][number], row, boxes))

tiles = []
for _, _, image, row, boxes in sorted(samples, key=lambda entry: entry[:2], reverse=True)[:3]:
    grey = np.uint8(image if image.dtype == np.uint8 else np.rint(255 * image))
    tile = cv2.cvtColor(grey.repeat(2, axis=0).repeat(2, axis=1), cv2.COLOR_GRAY2BGR)
    for box in boxes:
        if box["range_m"] is None:
            continue
        # Metres ahead and to the left: the ring around the echoes, and the ground of the box.
        bearing = np.deg2rad(np.linspace(*box["bearing_deg"], 20))
        turn = np.append(bearing, bearing[::-1])
        ring = np.repeat(box["range_m"], 20) * np.exp(-1j * turn)
        corners = np.array([1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j]) / 2
        ground = corners.real * box["size_m"][0] + 1j * corners.imag * box["size_m"][1]
        x, y, z = box["centre_m"]
        ground = x + 1j * y + ground * np.exp(1j * np.deg2rad(box["yaw_deg"]))
        # An image shows how far away things are, also those above or below.
        ground *= np.sqrt(1 + (z / np.abs(ground)) ** 2)
        for points, colour in ((ring, (90, 200, 255)), (ground, (120, 255, 120))):
            # The sonar is below the middle of the image, whose top is the far end of its range.
            place = np.stack([-points.imag, row["range_max_m"] - points.real], axis=-1)
            pixels = 2 * place / row["metres_per_pixel"] + (image.shape[1], 0)
            cv2.polylines(tile, [np.int32(np.rint(pixels))], True, colour, 1, cv2.LINE_AA)
        text = f"{box['class']} {100 * box['insonified']:.0f} %"
        left, top = np.int32(pixels.min(0))
        cv2.putText(tile, text, (left, top - 4), 0, 0.4, (90, 200, 255), 1, cv2.LINE_AA)
    tiles.append(tile)
cv2.imwrite(out, np.hstack(tiles))
print(f"{out}: {len(samples)} images, {sum(len(entry[4]) for entry in samples)} boxes")
