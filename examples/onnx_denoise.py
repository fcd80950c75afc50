"""Denoises an image on any machine with numpy, onnxruntime and Pillow.

simnfnd export-weights simnfnd --to onnx --out any.onnx
python examples/onnx_denoise.py any.onnx image.png denoised.png

simnfnd export-weights simnfnd --to onnx --geometry fan --out fan.onnx
python -c "import simnfnd; from simnfnd.models.recordings.fan_tables import write_fans; \
    write_fans('fans.csv', {'image.png': simnfnd.open_recording('image.png')[0].geometry})"
python examples/onnx_denoise.py fan.onnx image.png denoised.png fans.csv
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


if len(sys.argv) < 4:
    sys.exit(__doc__)
model, source, target, *table = sys.argv[1:]
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
inputs = {name: values[None, None].astype(np.float32) for name, values in inputs.items()}
session = onnxruntime.InferenceSession(model)
denoised, *weight = session.run(None, inputs)
Image.fromarray(np.rint(255 * denoised[0, 0]).astype(np.uint8)).save(target)
print(f"{target}: {' x '.join(map(str, image.shape))}", *weight)
