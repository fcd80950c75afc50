"""Wide pictures on the page of `evaluate real`, in a real browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.evaluation.report.page import as_data_uri, own_file, render
from tests.evaluation.report import browser


@pytest.mark.skipif(browser.program() is None, reason="no browser here")
@pytest.mark.parametrize("width_px", [390, 1280])
def test_they_are_seen_whole(tmp_path: Path, width_px: int) -> None:
    picture = as_data_uri(np.linspace(0, 1, 1600 * 200, dtype=np.float32).reshape(200, 1600))
    lists, tables = ("verdicts", "lines", "names"), ("columns", "cells", "notes")
    empty: dict[str, Any] = {**{name: [] for name in lists}, **{name: {} for name in tables}}
    strips = [("a dive", True, [("noisy", picture), ("median", picture)])]
    page = tmp_path / "real.html"
    page.write_text(
        render(
            "real.html", css=own_file("page.css"), title="t", about="", truth=False,
            by_group=([], []), in_time=None, rules=[], strips=strips, **empty,
        ),
        encoding="utf-8",
    )  # fmt: skip
    boxes = """
    const boxes = [...page.document.images].map((one) => one.getBoundingClientRect());
    return {wide: page.document.documentElement.scrollWidth,
            boxes: boxes.map(({width, height, right}) => [width, height, right])};
    """
    found = browser.found_on(page, boxes, tmp_path, size=(width_px, 844))
    assert (found["wide"], found["complaints"]) == (width_px, [])
    for width, height, right in found["boxes"]:
        assert right <= width_px
        assert width / height == pytest.approx(8, rel=0.02)
