"""`simnfnd evaluate counts`: a table, counts.json and a figure of lengths."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, write_atomically
from ...factory.common.plots import Curve, Plot, draw_plots
from ...factory.common.progress import stage
from ...factory.production.cli import markdown
from .judge import MeasuredLength, RecordingCounts, judge_dataset

_RANGES_M = ((0, 3), (3, 8), (8, 100))


def main(words: Sequence[str]) -> int:
    """`simnfnd evaluate counts DATASET [--out DIR]`."""
    parser = Parser(prog="simnfnd evaluate counts")
    help_text = "dataset of recordings with dataset.columns=[pose,tracks]"
    parser.add_argument("dataset", metavar="DATASET", help=help_text)
    parser.add_argument("--out", metavar="DIR", help="folder for counts.json and lengths.svg")
    options = parser.parse_args(list(words))
    folder = Path(options.dataset).expanduser()
    out = Path(options.out or Path("outputs", "counts", folder.name)).expanduser()
    check_writable(out, "--out")
    recordings = []
    for recording in judge_dataset(folder):
        stage(f"{recording.name}: {recording.found.total()} of {recording.true.total()} counted")
        recordings.append(recording)
    if not recordings:
        raise FactoryError(f"{folder}: has no recording")
    facts = _facts(recordings)
    write_atomically(out / "counts.json", json.dumps(facts, indent=1).encode(), key="--out")
    write_atomically(out / "lengths.svg", _figure(recordings), key="--out")
    print(_table(recordings))
    print(_summary(facts))
    print(f"report: {out / 'counts.json'}")
    return 0


def _facts(recordings: Sequence[RecordingCounts]) -> dict[str, object]:
    true_count = sum(recording.true.total() for recording in recordings)
    error = sum(recording.error for recording in recordings)
    lengths = [length for recording in recordings for length in recording.lengths]
    return {
        "recordings": len(recordings),
        "true": true_count,
        "counted": sum(recording.found.total() for recording in recordings),
        "count_error": error / true_count if true_count else None,
        "idf1": _mean([recording.scores.idf1 for recording in recordings]),
        "hota": _mean([recording.scores.hota for recording in recordings]),
        "lengths": {
            f"{near} to {far} m": _spread(
                [length for length in lengths if near <= length.range_m < far]
            )
            for near, far in _RANGES_M
        },
    }


def _mean(values: Sequence[float]) -> float | None:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.mean(finite)) if finite else None


def _spread(lengths: Sequence[MeasuredLength]) -> dict[str, float | int]:
    """Number of lengths, and bias and standard deviation in centimetres."""
    if not lengths:
        return {"tracks": 0}
    errors_cm = [100 * (length.estimated_m - length.true_m) for length in lengths]
    return {
        "tracks": len(lengths),
        "bias_cm": round(float(np.mean(errors_cm)), 2),
        "deviation_cm": round(float(np.std(errors_cm)), 2),
    }


def _table(recordings: Sequence[RecordingCounts]) -> str:
    head = ["recording", "true", "counted", "error", "IDF1", "HOTA"]
    rows = [
        [
            recording.name,
            str(recording.true.total()),
            str(recording.found.total()),
            str(recording.error),
            f"{recording.scores.idf1:.2f}",
            f"{recording.scores.hota:.2f}",
        ]
        for recording in recordings
    ]
    return markdown(head, rows)


def _summary(facts: dict[str, object]) -> str:
    error = facts["count_error"]
    share = "-" if error is None else f"{100 * float(str(error)):.0f} %"
    return (
        f"{facts['counted']} objects counted, {facts['true']} there; count error {share} "
        "(summed over recordings and directions)"
    )


def _figure(recordings: Sequence[RecordingCounts]) -> bytes:
    """True length over estimated length of all tracks."""
    lengths = sorted(length for recording in recordings for length in recording.lengths)
    true = [length.true_m for length in lengths]
    curves = {
        "estimated": Curve(true, [length.estimated_m for length in lengths]),
        "true": Curve(true, true),
    }
    return draw_plots([Plot("Lengths", "true length, m", "estimated length, m", curves)])
