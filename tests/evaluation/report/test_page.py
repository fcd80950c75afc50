"""report.html in a real browser: no complaint, no network, and everything that moves moves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from simnfnd.evaluation.report import build as builder
from simnfnd.evaluation.report import measure, page
from tests.evaluation.evaluation_settings import settings_for
from tests.evaluation.report import browser
from tests.small_dataset import write_dataset

needs_browser = pytest.mark.skipif(
    browser.found() is None, reason=f"no browser here ({', '.join(browser.NAMES)})"
)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("page")
    dataset = write_dataset(root / "data", train=0, test=11, size=48, per_shard=11)
    names = ["median", "gaussian", "grey_opening", "recursive"]
    builder.build(settings_for(dataset, out=str(root / "out"), baselines=names, texture=True))
    return root / "out" / page.PAGE_NAME


def test_it_is_one_file_that_asks_nobody(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    for word in ("http://", "https://", "//cdn", "@import", "url("):
        assert word not in text
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=\"(?!data:)", text)


def test_pictures_inside_are_lossless() -> None:
    import base64

    import cv2

    image = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16)
    head, content = measure.as_data_uri(image).split(",", 1)
    assert head == "data:image/png;base64"
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(pixels, np.arange(256).reshape(16, 16))


BOARD = "[...document.querySelector('table.board').tBodies[0].rows]"
KEPT = f"{BOARD}.filter((row) => !row.classList.contains('lost'))"
FIRST = f"{BOARD}.map((row) => row.cells[0].dataset.value)"


@needs_browser
def test_a_reader_can_use_it(report: Path) -> None:
    with browser.Browser() as page_:
        page_.screen(1280, 900, dark=False)
        page_.open(report)
        page_.until("document.querySelector('.stage').dataset.painted >= 2")
        _sorts(page_)
        _slides(page_)
        _paints(page_)
        _changes_light(page_)
        page_.screen(390, 844, dark=True)
        page_.open(report)
        page_.until("document.querySelector('.stage').dataset.painted >= 2")
        assert page_.run("document.documentElement.dataset.theme") == "dark"
        assert page_.run("document.documentElement.scrollWidth") == 390, (
            "the page runs off the side"
        )
        wide = "[...document.querySelectorAll('table.board')].map((table) => table.scrollWidth)"
        assert max(page_.run(wide)) <= 390, "every figure is seen without a sideways scroll"
        second = "document.querySelector('.board td:nth-child(2)')"
        assert page_.run(f"getComputedStyle({second}, '::before').content") == '"PSNR, dB"'
        assert page_.pdf().startswith(b"%PDF"), "it prints"
        assert page_.complaints == []
        asked = [url for url in page_.events if not url.startswith(("data:", "file:"))]
        assert asked == []


def _sorts(page_: browser.Browser) -> None:
    assert page_.run(FIRST)[-1] == "recursive", "lost: one frame has a single look"
    before = page_.run(FIRST)
    ms = f"{KEPT}.map((row) => Number(row.cells[row.cells.length - 1].dataset.value))"
    # From the keyboard: the last head's button, Enter.
    page_.run("[...document.querySelectorAll('table.board')][0].tHead.querySelectorAll('button')[8].focus()")  # fmt: skip  # noqa: E501
    assert page_.run("document.activeElement.textContent") == "shadow IoU"
    page_.run("[...document.querySelectorAll('table.board')][0].tHead.querySelectorAll('button')[9].focus()")  # fmt: skip  # noqa: E501
    assert page_.run("document.activeElement.textContent") == "ms"
    page_.press("Enter", "\r")
    times = page_.run(ms)
    assert times == sorted(times)
    assert page_.run("document.activeElement.parentElement.ariaSort") == "ascending"
    page_.press(" ", " ")
    assert page_.run(ms) == times[::-1]
    assert page_.run(FIRST)[-1] == "recursive", "lost rows stay last"
    assert sorted(page_.run(FIRST)) == sorted(before)
    # By the mouse: the second column, best first.
    page_.run("document.querySelector('table.board thead th:nth-child(2) button').click()")
    psnr = page_.run(f"{KEPT}.map((row) => Number(row.cells[1].dataset.value))")
    assert psnr == sorted(psnr, reverse=True)


def _slides(page_: browser.Browser) -> None:
    page_.run("document.querySelector('.stage').scrollIntoView()")
    clip = "document.querySelector('.layer.second').style.clipPath"
    assert page_.run(clip) == "inset(0px 0px 0px 50%)"
    page_.run("document.querySelector('#slider').focus()")
    for _ in range(3):
        page_.press("ArrowRight")
    assert page_.run(clip) == "inset(0px 0px 0px 51.5%)"
    box = page_.run("JSON.parse(JSON.stringify(document.querySelector('.stage').getBoundingClientRect()))")  # fmt: skip  # noqa: E501
    x, y, width = box["x"], box["y"] + 100, box["width"]
    page_.drag([(x + 0.5 * width, y), (x + 0.4 * width, y), (x + 0.25 * width, y)])
    share = float(page_.run(clip).split()[-1].rstrip("%)"))
    assert share == pytest.approx(25, abs=0.6)
    # Zoom keeps what is in the middle; dragging moves the picture then.
    transform = "document.querySelector('.layer.second canvas').style.transform"
    page_.run("document.querySelector('#closer').click()")
    assert "scale(1.5)" in page_.run(transform)
    before = page_.run(transform)
    page_.drag([(x + 0.5 * width, y), (x + 0.4 * width, y)])
    assert page_.run(transform) != before
    page_.run("document.querySelector('.stage').focus()")
    page_.press("0", "0")
    assert "scale(1)" in page_.run(transform)


def _paints(page_: browser.Browser) -> None:
    """The error of clean against clean is black, of another picture it is not."""
    page_.run(
        "(() => { const set = (id, value) => { const one = document.querySelector(id);"
        " one.value = value; one.dispatchEvent(new Event('change')); };"
        " set('#after', 'clean'); set('#map', 'error'); })()"
    )
    sums = (
        "['first', 'second'].map((side) => { const from = document.querySelector("
        "`.layer.${side} canvas`); const canvas = new OffscreenCanvas(from.width, from.height);"
        " const context = canvas.getContext('2d', { willReadFrequently: true });"
        " context.drawImage(from, 0, 0);"
        " const data = context.getImageData(0, 0, from.width, from.height).data;"
        " return data.reduce((sum, v, i) => i % 4 === 3 ? sum : sum + v, 0); })"
    )
    page_.until(f"({sums})[1] === 0 && ({sums})[0] > 0")
    assert page_.run("document.querySelector('.tag.after').textContent") == "clean"
    assert page_.run("/^noisy, \\d+\\.\\d\\d dB$/.test(document.querySelector('.tag.before').textContent)")  # fmt: skip  # noqa: E501


def _changes_light(page_: browser.Browser) -> None:
    back = "getComputedStyle(document.body).backgroundColor"
    assert page_.run(back) == "rgb(255, 255, 255)"
    page_.run("document.querySelector('#theme').click()")
    assert page_.run(back) == "rgb(18, 23, 29)"
