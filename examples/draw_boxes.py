"""Boxes of the objects on a sonar fan, from the column `boxes`.

python examples/draw_boxes.py outputs/valves valves.png

Draws the pictures with most objects of a class of your own (a third word: of that class): the box
around the echoes in range and bearing, and the ground of the 3-D box.
"""

import json
import sys
from pathlib import Path

import cv2
import h5py
import numpy as np

SHOWN, TIMES = 6, 2
folder, out = Path(sys.argv[1]), sys.argv[2]
wanted = sys.argv[3] if len(sys.argv) > 3 else None

found = []
for path in sorted(folder.glob("*/shard-*.h5")):
    with h5py.File(path) as shard:
        if "boxes" not in shard["meta"].dtype.names:
            sys.exit(f"{folder} has no boxes; make it with dataset.columns=[boxes]")
        own = {wanted} if wanted else set(shard["segmentation"].attrs["classes"][21:])
        for number, row in enumerate(shard["meta"]):
            boxes = [box for box in json.loads(row["boxes"]) if box["class"] in own]
            heard = sum(box["insonified"] for box in boxes)
            found.append((heard, len(found), shard["noisy"][number], row, boxes))

tiles = []
for _, _, picture, row, boxes in sorted(found, key=lambda one: (-one[0], one[1]))[:SHOWN]:
    height, width = picture.shape
    # The sonar is below the middle of the picture, whose top is the far end of its range.
    far_m, pixel_m = row["range_max_m"], row["metres_per_pixel"]

    def place(ahead_m, right_m, far_m=far_m, pixel_m=pixel_m, width=width):
        """Column and row of points on the ground."""
        x = width / 2 + np.asarray(right_m) / pixel_m
        y = (far_m - np.asarray(ahead_m)) / pixel_m
        return np.round(TIMES * np.stack([x, y], axis=-1)).astype(np.int32)

    grey = np.uint8(picture if picture.dtype == np.uint8 else np.rint(255 * picture))
    larger = cv2.resize(grey, None, fx=TIMES, fy=TIMES, interpolation=cv2.INTER_NEAREST)
    tile = cv2.cvtColor(larger, cv2.COLOR_GRAY2BGR)
    for box in boxes:
        if box["range_m"] is None:
            continue
        low, high = box["range_m"]
        bearing = np.deg2rad(np.linspace(*box["bearing_deg"], 20))
        ring_m, turn = np.repeat([low, high], 20), np.concatenate([bearing, bearing[::-1]])
        ring = place(ring_m * np.cos(turn), ring_m * np.sin(turn))
        cv2.polylines(tile, [ring], True, (90, 200, 255), 1, cv2.LINE_AA)
        (x, y, z), (length, across, _) = box["centre_m"], box["size_m"]
        yaw = np.deg2rad(box["yaw_deg"])
        along = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (length / 2, across / 2)
        ahead = x + along[:, 0] * np.cos(yaw) - along[:, 1] * np.sin(yaw)
        left = y + along[:, 0] * np.sin(yaw) + along[:, 1] * np.cos(yaw)
        # A picture shows how far away things are, also those above or below.
        slant = np.sqrt(1 + z**2 / (ahead**2 + left**2))
        cv2.polylines(tile, [place(slant * ahead, -slant * left)], True, (120, 255, 120), 1)
        text = f"{box['class']} {100 * box['insonified']:.0f} %"
        corner = place(high, high * np.sin(bearing[0])) - (0, 4)
        cv2.putText(tile, text, tuple(corner.tolist()), 0, 0.4, (90, 200, 255), 1, cv2.LINE_AA)
    tiles.append(tile)
columns = min(3, len(tiles))
tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
rows = [np.hstack(tiles[first : first + columns]) for first in range(0, len(tiles), columns)]
cv2.imwrite(out, np.vstack(rows))
print(f"{out}: {len(found)} pictures, {sum(len(one[4]) for one in found)} boxes")
