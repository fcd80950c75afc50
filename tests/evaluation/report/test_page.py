"""report.html in a real browser: no complaint, no network, and everything that moves moves."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.report import build as builder
from simnfnd.evaluation.report.document import as_data_uri
from tests.evaluation.evaluation_settings import settings_for
from tests.evaluation.filters.scenes import BROKEN
from tests.evaluation.report import browser
from tests.small_dataset import write_dataset

needs_browser = pytest.mark.skipif(
    browser.program() is None, reason=f"no browser here ({', '.join(browser.NAMES)})"
)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("page")
    dataset = write_dataset(root / "data", train=0, test=11, size=48, per_shard=11)
    names = ["median", "gaussian", "grey_opening", "broken"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(REGISTRY, "broken", BROKEN)
        builder.build(settings_for(dataset, out=str(root / "out"), baselines=names))
    return root / "out" / builder.PAGE_NAME


def test_it_is_one_file_that_asks_nobody(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    for word in ("http://", "https://", "//cdn", "@import"):
        assert word not in text
    assert not re.search(r"url\((?!#)", text), "parts of its own pictures alone"
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=\"(?!data:)", text)


def test_pictures_inside_are_lossless() -> None:
    image = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16)
    head, content = as_data_uri(image).split(",", 1)
    assert head == "data:image/png;base64"
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(pixels, np.arange(256).reshape(16, 16))


SORTED = """
const board = at("table.board"), rows = () => [...board.tBodies[0].rows];
const names = () => rows().map((row) => row.cells[0].textContent);
const figures = (column) => rows().filter((row) => !row.classList.contains("lost"))
  .map((row) => Number.parseFloat(row.cells[column].textContent));
const heads = board.tHead.querySelectorAll("button"), before = names();
heads[1].click();
const down = figures(1), order = heads[1].parentElement.ariaSort;
heads[1].click();
return {before, after: names(), up: figures(1), down, order};
"""
LOOKED_AT = """
while (!(at(".stage").dataset.painted >= 2)) await wait(20);
const clip = () => at(".layer.second").style.clipPath;
const middle = clip(), slider = at("#slider");
slider.value = 25; slider.dispatchEvent(new page.Event("input"));
const moved = clip();
const scale = () => at(".layer.second canvas").style.transform;
at("#closer").click(); const near = scale();
at("#whole").click(); const whole = scale();
const set = (id, value) => {
  at(id).value = value;
  at(id).dispatchEvent(new page.Event("change"));
};
set("#after", "clean"); set("#map", "error");
const sum = (side) => {
  const from = at(`.layer.${side} canvas`);
  const canvas = new OffscreenCanvas(from.width, from.height), context = canvas.getContext("2d");
  context.drawImage(from, 0, 0);
  const data = context.getImageData(0, 0, from.width, from.height).data;
  return data.reduce((all, value, i) => i % 4 === 3 ? all : all + value, 0);
};
while (sum("second") > 0) await wait(20);
const errors = [sum("first"), sum("second")];
const back = () => page.getComputedStyle(page.document.body).backgroundColor;
const light = back(); at("#theme").click();
return {middle, moved, near, whole, errors, light, dark: back(),
        tags: [at(".tag.before").textContent, at(".tag.after").textContent]};
"""


@needs_browser
def test_a_reader_can_sort_and_compare(report: Path, tmp_path: Path) -> None:
    found = browser.found_on(report, SORTED, tmp_path)
    assert (found["complaints"], found["asked"]) == ([], []), found
    assert found["before"][-1] == "broken"
    assert found["after"][-1] == "broken", "lost rows stay last"
    assert found["order"] == "descending"
    assert found["down"] == sorted(found["down"], reverse=True)
    assert found["up"] == found["down"][::-1]
    seen = browser.found_on(report, LOOKED_AT, tmp_path)
    assert seen["complaints"] == []
    assert seen["middle"] == "inset(0px 0px 0px 50%)"
    assert seen["moved"] == "inset(0px 0px 0px 25%)"
    assert "scale(1.5)" in seen["near"]
    assert "scale(1)" in seen["whole"]
    assert seen["errors"][0] > 0 == seen["errors"][1], "clean has no error against clean"
    assert (seen["light"], seen["dark"]) == ("rgb(255, 255, 255)", "rgb(18, 23, 29)")
    assert re.fullmatch(r"noisy, \d+\.\d\d dB", seen["tags"][0])
    assert seen["tags"][1] == "clean"
