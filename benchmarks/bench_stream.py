"""Pairs a second and core that `PairStream` makes of cached renders, in batches of tensors."""

from __future__ import annotations

import tempfile
import time
from typing import TYPE_CHECKING

from benchmarks.shared import Options, Section, Table, in_own_process
from simnfnd import make_dataset

if TYPE_CHECKING:
    from simnfnd import PairStream

_BATCH = 16
# As large as a camera's image that suits 256 x 256 pixels, and as large as those of FLSea.
_SIZES = ((484, 304), (968, 608))


def measure(options: Options) -> Section:
    """A row for each formation and size of the rendered frames; images of 256 x 256 pixels."""
    rows = []
    for experiment, formation in (("demo", "pointwise"), ("demo_physical", "coherent")):
        for width, height in _SIZES[: options.amount(2, 1)]:
            words = (
                f"experiment={experiment}", "render=analytic", "dataset.preview_pairs=0",
                f"scenes.width={width}", f"scenes.height={height}", "split.test_fraction=0",
            )  # fmt: skip
            rates = in_own_process(stream_rates, words, options.amount(6, 1))
            rows.append((formation, f"{width} x {height}", *rates))
    columns = ("formation", "frame", "frames new", "frames in memory")
    note = "Pairs per second of CPU time, 256 x 256 pixels, one thread."
    return Section((Table(columns, rows, note=note),))


def stream_rates(words: tuple[str, ...], rounds: int) -> tuple[float, float]:
    """Pairs per CPU second: while each frame is read and observed, and once all are in memory."""
    import torch

    from simnfnd import PairStream

    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        words = (*words, f"cache.dir={folder}/cache")
        make_dataset(*words, "scheduler=serial", out=f"{folder}/data")
        compiled = PairStream(*words, batch_size=1)
        compiled.batch(0)
        stream = PairStream(*words, batch_size=_BATCH)
        new = _pairs_per_cpu_second(stream, range(1))
        return new, _pairs_per_cpu_second(stream, range(1, 1 + rounds))


def _pairs_per_cpu_second(stream: PairStream, batches: range) -> float:
    began = time.process_time()
    for number in batches:
        stream.batch(number)
    return len(batches) * _BATCH / (time.process_time() - began)
