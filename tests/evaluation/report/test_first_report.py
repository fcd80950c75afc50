"""What somebody sees who gives no options, on a dataset of a few frames."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.evaluation.metrics.statistics import frames_needed, holm, paired
from simnfnd.evaluation.report import build as builder
from tests.evaluation.evaluation_settings import settings_for
from tests.small_dataset import write_dataset


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    root = tmp_path_factory.mktemp("first")
    dataset = write_dataset(root / "data", train=6, test=3, size=32)
    settings = settings_for(
        dataset, out=str(root / "out"), models="auto", tuning={"auto": True}, bootstrap=100
    )
    return builder.build(settings), root / "out"


def board(text: str) -> list[str]:
    """First cells of the first Markdown table."""
    lines = text.partition("| method")[2].partition("\n\n")[0].splitlines()[2:]
    return [line.split("|")[1].strip() for line in lines]


def test_the_network_that_ships_has_a_row(made: tuple[dict[str, Any], Path]) -> None:
    content, _ = made
    networks = [row for row in content["rows"] if row["kind"] == "network"]
    assert [row["name"].removesuffix("-paper") for row in networks] == ["simnfnd"]
    assert networks[0]["lost"] is None


def test_each_method_has_one_row_and_its_other_forms_stand_below(
    made: tuple[dict[str, Any], Path],
) -> None:
    content, out = made
    assert len(content["rows"]) == 6  # noisy, median in four forms, the network
    report = (out / "report.md").read_text()
    first = board(report)
    assert len(first) == 3
    assert sum(name.startswith("median") for name in first) == 1
    medians = [row for row in content["rows"] if row["name"] == "median"]
    assert first[[name.startswith("median") for name in first].index(True)].startswith(
        max(medians, key=lambda row: row["metrics"]["psnr"]["mean"])["label"]
    )
    assert len(board(report.partition("## All forms")[2])) == 6
    page = (out / "report.html").read_text()
    boards = re.findall(r'<table class="board sortable">.*?</table>', page, re.DOTALL)
    assert [one.count("<tr class=") for one in boards[:2]] == [3, 6]
    assert "<summary>All 6 forms" in page


def test_few_frames_are_told_wherever_p_is(made: tuple[dict[str, Any], Path]) -> None:
    content, out = made
    said = content["facts"]["few_frames"]
    assert said.startswith("With 2 frames and 5 comparisons p (Holm) cannot fall below 0.05")
    for name in ("report.md", "report.html"):
        assert said in (out / name).read_text()


def test_so_many_frames_are_needed_as_told() -> None:
    for comparisons in (1, 3, 20):
        needed = frames_needed(comparisons)
        for frames, shown in ((needed, True), (needed - 1, False)):
            values = [float(frame) for frame in range(1, frames + 1)]
            zeros = [0.0] * frames
            names = [str(frame) for frame in range(frames)]
            result = paired(
                np.array(values), np.array(zeros), names, better=1, resamples=100, seed=0
            )
            assert (holm([result.p] * comparisons)[0] < 0.05) is shown
