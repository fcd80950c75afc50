"""Which part of the samples a process takes, where several read the same dataset."""

from __future__ import annotations

import sys
from typing import NamedTuple


class Share(NamedTuple):
    """Every `processes`-th sample, from sample `number` on."""

    number: int
    processes: int


WHOLE = Share(0, 1)


def loader_share() -> Share:
    """The share of this worker of a torch DataLoader; `WHOLE` in any other process.

    Looks at torch where the program has loaded it, and never loads it.
    """
    torch_data = sys.modules.get("torch.utils.data")
    worker = torch_data.get_worker_info() if torch_data is not None else None
    if worker is None:
        return WHOLE
    return Share(worker.id, worker.num_workers)
