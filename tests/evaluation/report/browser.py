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
_WATCH = """<script>
parent.complaints = [];
addEventListener("error", (event) => parent.complaints.push(String(event.message)));
console.error = console.warn = (...words) => parent.complaints.push(words.join(" "));
</script>"""
_SHELL = """<!DOCTYPE html><title>shell</title><pre id="found"></pre>
<iframe style="border:0" width="%d" height="%d" srcdoc="%s"></iframe>
<script>
document.querySelector("iframe").onload = async (event) => {
  const page = event.target.contentWindow, at = (name) => page.document.querySelector(name);
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  let found;
  try { found = await (async () => { %s })(); } catch (error) { found = {broken: String(error)}; }
  const asked = page.performance.getEntriesByType("resource").map((one) => one.name);
  document.querySelector("#found").textContent =
    JSON.stringify({...found, complaints, asked: asked.filter((url) => !url.startsWith("data:"))});
};
</script>"""


def program() -> str | None:
    """The browser's program, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def found_on(page: Path, script: str, folder: Path, *, size: tuple[int, int]) -> dict[str, Any]:
    """What `script` returns of a page of this width and height.

    script: body of an async function; `page` is the page's window, `at(selector)` an element of it,
    `wait(ms)` a promise.  `complaints` and `asked` are added: its console, and what it fetched.
    """
    browser = program()
    assert browser is not None
    content = html.escape(_WATCH + page.read_text(encoding="utf-8"), quote=True)
    shell = folder / "shell.html"
    shell.write_text(_SHELL % (*size, content, script), encoding="utf-8")
    flags = ["--headless", "--hide-scrollbars", "--no-sandbox", "--disable-gpu",
             "--disable-dev-shm-usage",
             f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=20000",
             "--window-size=1600,1200", "--dump-dom"]  # fmt: skip
    done = subprocess.run(
        [browser, *flags, shell.as_uri()], capture_output=True, text=True, check=True, timeout=180
    )
    written = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert written is not None
    assert written[1], "the page did not load"
    found: dict[str, Any] = json.loads(html.unescape(written[1]))
    return found
