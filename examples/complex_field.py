"""The complex field of a sonar: its level in decibels, and images with more looks than one.

simnfnd make experiment=physical render=embree scenes.locations=1 dataset.dir=outputs/field \
    sonar.image.layout=polar dataset.layers=[field,intensity_db] dataset.columns=[calibration]
python examples/complex_field.py outputs/field

The field is in uPa at the receiver, before time-varying gain.  Averaging the intensity of
neighbouring ranges (looks) makes its speckle smoother, as a real receiver's display does.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
shards = sorted(folder.glob("*/shard-*.h5"))
if not shards:
    sys.exit(f"{folder}: no shards below it; give the folder of a dataset")
with h5py.File(shards[0]) as shard:
    if "field" not in shard:
        sys.exit(f"{folder} has no layer field; make it as the first lines say")
    field = shard["field"][0]
    level_db = shard["intensity_db"][0]
    row = shard["meta"][0]

intensity = np.abs(field.astype(np.complex128)) ** 2
heard = intensity > 0
difference = 10 * np.log10(intensity[heard]) - level_db[heard]
print(f"field {field.shape} {field.dtype}")
print(f"source level {row['source_level_db']:.0f} dB re 1 uPa at 1 m")
print(f"median level {np.median(level_db[heard]):.1f} dB re 1 uPa")
print(f"10 log10 |field|^2 less intensity_db: at most {np.abs(difference).max():.4f} dB")

for looks in (1, 2, 4):
    rows = len(intensity) // looks * looks
    mean = intensity[:rows].reshape(-1, looks, intensity.shape[1]).mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps_db = np.diff(10 * np.log10(mean), axis=1)
    grain_db = steps_db[np.isfinite(steps_db)].std()
    print(f"{looks} looks: neighbouring beams differ by {grain_db:.2f} dB")
