"""What a training costs: CPU and elapsed time over all its sittings, in cost.json."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import psutil

from ...factory.common.files import write_atomically

COST_NAME = "cost.json"


@dataclass(frozen=True)
class Cost:
    """Time that a training took.

    cpu_s: CPU time of the training and its reading processes.  elapsed_s: time on the wall clock.

    sittings: how often it was started.  What a killed sitting did after its last checkpoint is done
    again, and does not count twice.
    """

    cpu_s: float = 0.0
    elapsed_s: float = 0.0
    sittings: int = 0


def read_cost(folder: Path) -> Cost:
    """The cost in the folder of a training; zero where there is none that can be read."""
    try:
        return Cost(**json.loads((folder / COST_NAME).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return Cost()


class CostMeter:
    """Counts a sitting, from its construction on."""

    def __init__(self, before: Cost) -> None:
        """before: of earlier sittings of the same training."""
        self._before = replace(before, sittings=before.sittings + 1)
        self._process = psutil.Process()
        self._cpu_s = self._count_cpu()
        self._elapsed_s = time.monotonic()
        self._counted = self._before

    def write(self, folder: Path) -> None:
        """Keep the cost up to now."""
        # The time of a process that ends counts for nothing until it is waited for.
        cpu_s = max(self._before.cpu_s + self._count_cpu() - self._cpu_s, self._counted.cpu_s)
        elapsed_s = self._before.elapsed_s + time.monotonic() - self._elapsed_s
        self._counted = Cost(cpu_s, elapsed_s, self._before.sittings)
        content = json.dumps(asdict(self._counted), indent=2) + "\n"
        write_atomically(folder / COST_NAME, content.encode(), durable=False, key="out")

    def _count_cpu(self) -> float:
        """CPU seconds of this process, of its children that run, and of those that have ended."""
        own = self._process.cpu_times()
        total = own.user + own.system + own.children_user + own.children_system
        for child in self._process.children(recursive=True):
            try:
                times = child.cpu_times()
            except psutil.Error:  # it has just ended
                continue
            total += times.user + times.system
        return float(total)
