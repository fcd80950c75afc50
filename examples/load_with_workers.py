"""A torch DataLoader with two worker processes.

python examples/load_with_workers.py outputs/demo
"""

import sys

from torch.utils.data import DataLoader

from simnfnd import FactoryError, PairDataset


def main() -> None:
    """Read one epoch in random order."""
    # It opens its files separately in each worker, however that was started.
    pairs = PairDataset(sys.argv[1], "train", layers=("noisy", "clean", "shadow"), scaled=True)
    loader = DataLoader(pairs, batch_size=4, shuffle=True, num_workers=2)
    count = 0
    shaded = 0.0
    for batch in loader:
        count += len(batch["noisy"])
        shaded += batch["shadow"].float().mean().item() * len(batch["shadow"])
        assert 0 <= batch["noisy"].min() <= batch["noisy"].max() <= 1
    print(f"{count} of {len(pairs)} pairs, {100 * shaded / count:.1f} % of the pixels in shadow")


# Workers that are spawned import this file again.
if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    try:
        main()
    except FactoryError as error:
        sys.exit(str(error))
