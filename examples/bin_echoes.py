"""All elevations in a bin: what a sonar's picture has lost, and `dataset.layers=[echoes]` keeps.

simnfnd make experiment=demo dataset.dir=outputs/echoes dataset.layers=[echoes]
python examples/bin_echoes.py outputs/echoes [SAMPLE] [RANGE_BIN BEAM]

Prints every echo of one bin, by default of the one whose elevations are farthest apart.  h5py alone
reads them; `PairDataset(...).echoes(SAMPLE)` of the package does, too.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

SHOWN = 20


def echoes_of(shard: h5py.File, sample: int) -> dict[str, np.ndarray]:
    """Every field of the sample's list, (N,) each; `bin` ascends."""
    first, end = shard["echoes/place"][sample]
    return {name: shard["echoes"][name][first:end] for name in shard["echoes"] if name != "place"}


def widest(bins: np.ndarray, elevation: np.ndarray) -> int:
    """The bin whose elevations are farthest apart."""
    first = np.flatnonzero(np.diff(bins, prepend=-1))  # where each bin begins
    span = np.maximum.reduceat(elevation, first) - np.minimum.reduceat(elevation, first)
    return int(bins[first[span.argmax()]])


if __name__ == "__main__":
    folder, numbers = Path(sys.argv[1]), [int(word) for word in sys.argv[2:]]
    with h5py.File(sorted(folder.glob("*/shard-*.h5"))[0]) as shard:
        if "echoes" not in shard:
            sys.exit(f"{folder} has no echoes; make it as the first lines say")
        beams = int(shard["echoes/bin"].attrs["grid"][1])
        echoes = echoes_of(shard, numbers[0] if numbers else 0)
    here = widest(echoes["bin"], echoes["elevation"])
    if len(numbers) == 3:
        here = numbers[1] * beams + numbers[2]
    first, end = np.searchsorted(echoes["bin"], [here, here + 1])
    range_bin, beam = divmod(here, beams)
    print(f"range bin {range_bin}, beam {beam}: {end - first} of {len(echoes['bin'])} echoes")
    loudest = first + np.argsort(-echoes["strength"][first:end], kind="stable")
    for k in loudest[:SHOWN]:
        label = f", class {echoes['segmentation'][k]}" if "segmentation" in echoes else ""
        print(
            f"  elevation {np.rad2deg(echoes['elevation'][k]):6.2f} deg, range "
            f"{echoes['range'][k]:.3f} m, strength {echoes['strength'][k]:.4g}{label}"
        )
