"""What somebody sees who gives no options, on a dataset of a few frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simnfnd.evaluation.metrics.statistics import frames_needed, holm, paired
from simnfnd.evaluation.report import build as builder
from tests.evaluation.evaluation_settings import settings_for
from tests.small_dataset import write_dataset


def test_the_network_that_ships_has_a_row_and_few_frames_are_told(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=6, test=3, size=32)
    settings = settings_for(
        dataset, out=str(tmp_path / "out"), models="auto", tuning={"auto": True}, bootstrap=100
    )
    content = builder.build(settings)
    assert len(content["rows"]) == 6  # noisy, median in four forms, the network
    (network,) = [row for row in content["rows"] if row["kind"] == "network"]
    assert network["name"].removesuffix("-paper") == "simnfnd"
    assert network["lost"] is None
    said = content["facts"]["few_frames"]
    assert said.startswith("With 2 frames and 5 comparisons p (Holm) cannot fall below 0.05")
    for name in ("report.md", "report.html"):
        assert said in (tmp_path / "out" / name).read_text()


def test_so_many_frames_are_needed_as_told() -> None:
    for comparisons in (1, 3, 20):
        needed = frames_needed(comparisons)
        for frames, shown in ((needed, True), (needed - 1, False)):
            values, names = np.arange(1.0, frames + 1), [str(frame) for frame in range(frames)]
            result = paired(values, 0 * values, names, better=1, resamples=100, seed=0)
            assert (holm([result.p] * comparisons)[0] < 0.05) is shown
