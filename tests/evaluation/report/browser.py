"""A page in a real browser: Chromium without a window runs a script in it and prints the answer."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
_WATCH = """<head><script>
const complaints = [];
addEventListener("error", (event) => complaints.push(String(event.message)));
console.error = console.warn = (...words) => complaints.push(words.join(" "));
</script>"""
_ASK = """<script>(async () => {
const page = window, at = (name) => document.querySelector(name);
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const found = await (async () => { %s })().catch((error) => ({broken: String(error)}));
const asked = performance.getEntriesByType("resource").map((one) => one.name);
document.title = JSON.stringify(
  {...found, complaints, asked: asked.filter((url) => !url.startsWith("data:"))});
})();</script>"""


def program() -> str | None:
    """The browser's program, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def found_on(page: Path, script: str, folder: Path) -> dict[str, Any]:
    """What `script` returns of a page, with its complaints and what it asked the network for.

    script: body of an async function; `page` is the page's window, `at(selector)` an element of it,
    `wait(ms)` a promise.
    """
    copy = folder / "page.html"
    text = page.read_text(encoding="utf-8").replace("<head>", _WATCH, 1)
    copy.write_text(text + _ASK % script, encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
             f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=20000",
             "--window-size=1280,900", "--dump-dom"]  # fmt: skip
    command = [str(program()), *flags, copy.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=180)
    written = re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)
    assert written is not None
    found: dict[str, Any] = json.loads(html.unescape(written[1]))
    return found
