"""Denoises an image on any machine with numpy, onnxruntime and Pillow.

simnfnd export-weights simnfnd --to onnx --out any.onnx
python examples/onnx_denoise.py any.onnx image.png denoised.png

simnfnd export-weights simnfnd --to onnx --geometry fan --out fan.onnx
python -c "import simnfnd; from simnfnd.models.recordings.fan_tables import write_fans; \
    write_fans('fans.csv', {'image.png': simnfnd.open_recording('image.png')[0].geometry})"
python examples/onnx_denoise.py fan.onnx image.png denoised.png fans.csv

simnfnd export-weights simnfnd --to onnx --geometry polar --out polar.onnx
python examples/onnx_denoise.py polar.onnx ping.png denoised.png 130 0.1

The last is for pings: a row a range, near range first, and a column a beam, evenly from left to
right over 130 degrees; the first range is .1 of the last one (0 if it is left out).
"""

import csv
import sys
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image


def maps(row, height, width):
    """Range, bearing and sector of every pixel, from a line of the table of fans."""
    apex_x, apex_y, slope, top, bottom, squeeze = (
        float(row[name])
        for name in ("apex_x", "apex_y", "edge_slope", "top_row", "bottom_row", "squeeze")
    )
    half = np.arctan(slope / squeeze)
    far = apex_y - top
    near = (apex_y - bottom) / np.cos(half)
    ahead = apex_y - np.arange(height)[:, None]
    right = (np.arange(width)[None] - apex_x) / squeeze
    range_fraction = np.hypot(ahead, right) / far
    azimuth_rad = np.arctan2(right, ahead)
    sector = (range_fraction >= near / far) & (range_fraction <= 1) & (abs(azimuth_rad) <= half)
    return {"range_fraction": range_fraction, "azimuth_rad": azimuth_rad, "sector": sector}


def polar_maps(opening_deg, near_fraction, height, width):
    """The same of a ping whose ranges and beams are even."""
    row = (np.arange(height)[:, None] + 0.5) / height
    column = (np.arange(width)[None] + 0.5) / width
    range_fraction = near_fraction + (1 - near_fraction) * row
    azimuth_rad = np.radians(opening_deg) * (column - 0.5)
    whole = np.ones((height, width))
    return {
        "range_fraction": range_fraction * whole,
        "azimuth_rad": azimuth_rad * whole,
        "sector": whole,
    }


if len(sys.argv) < 4:
    sys.exit(__doc__)
model, source, target, *geometry = sys.argv[1:]
table = [word for word in geometry[:1] if word.endswith(".csv")]
for name in (model, source, *table):
    if not Path(name).is_file():
        sys.exit(f"{name}: no such file; give it as the first lines of this program say")
image = np.asarray(Image.open(source).convert("L"))
inputs = {"noisy": image / 255}
if table:
    with open(table[0], newline="", encoding="utf-8") as file:
        rows = {row["file"]: row for row in csv.DictReader(file)}
    if Path(source).name not in rows:
        sys.exit(f"{table[0]}: no line of {Path(source).name}")
    inputs |= maps(rows[Path(source).name], *image.shape)
elif geometry:
    opening_deg, near_fraction = (float(word) for word in (*geometry, "0")[:2])
    inputs |= polar_maps(opening_deg, near_fraction, *image.shape)
inputs = {name: values[None, None].astype(np.float32) for name, values in inputs.items()}
session = onnxruntime.InferenceSession(model)
denoised, *weight = session.run(None, inputs)
Image.fromarray(np.rint(255 * denoised[0, 0]).astype(np.uint8)).save(target)
print(f"{target}: {' x '.join(map(str, image.shape))}", *weight)
