"""Reads the batches of a training, in processes of its own where that is faster."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from typing import Any

import torch
from torch.utils.data import DataLoader

from ...factory.common.errors import FactoryError
from ...factory.common.private_apis import children_allowed, end_reading_processes
from ..data.crops import LANES, Crops, KeptSource, VisitSampler, concatenate
from ..data.pairs import Batch, Data
from ..settings import DataSettings, ModelsSettings, RenderedData


class BatchReader:
    """The batches that follow any step.

    extras: what the network takes beside the image.
    """

    def __init__(
        self, settings: ModelsSettings, device: torch.device, data: Data, extras: tuple[str, ...]
    ) -> None:
        kind = settings.data
        workers = _reading_processes(kind, device)
        options: dict[str, Any] = {"num_workers": workers, "pin_memory": device.type != "cpu"}
        if workers:
            # spawn: a fork would copy HDF5's and torch's threads in whatever state they are.
            options |= {"multiprocessing_context": "spawn", "persistent_workers": True}
            options["worker_init_fn"] = _leave_ctrl_c
        source = data.learning
        if kind.reuse > 1:
            source = KeptSource(source, max(1, workers))
        crops = Crops(source, kind, settings.seed, extras)
        interval = settings.train.check_every
        places = data.learning.places
        self._visits = VisitSampler(len(source), kind, interval, settings.seed, places)
        self._batches: DataLoader[Batch] = DataLoader(
            crops, batch_sampler=self._visits, collate_fn=concatenate, **options
        )

    def after(self, step: int) -> Iterator[Batch]:
        """The batches from a step to the next check."""
        self._visits.step = step
        with children_allowed():
            return iter(self._batches)

    def close(self) -> None:
        """End the reading processes, which the traceback of an error would keep alive."""
        end_reading_processes(self._batches)


def innermost_message(error: FactoryError) -> str:
    """The message itself; a reading process wraps it in the text of its traceback."""
    last = str(error).strip().splitlines()[-1]
    return last.removeprefix(f"{FactoryError.__module__}.{FactoryError.__qualname__}: ")


def _reading_processes(data: DataSettings, device: torch.device) -> int:
    """How many processes make the crops; 0: the training itself."""
    cores = os.cpu_count() or 1
    if data.workers != "auto":
        return data.workers
    if device.type == "cpu":
        # A network keeps every core busy, unless pairs have to be made for it.
        return 1 if isinstance(data, RenderedData) and cores > 1 else 0
    available = min(LANES, max(1, cores - 1))
    # A divisor of LANES, so that each lane stays with one process.
    return max(count for count in (1, 2, 4, 8) if count <= available)


def _leave_ctrl_c(_: int) -> None:
    """A reading process goes on until the training has kept its checkpoint."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
