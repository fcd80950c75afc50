"""A page of `simnfnd view` or `lab` in headless Chromium, in real time."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

from simnfnd.evaluation.viewer.page_server import Answer, PageServer, json_answer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
_LIMIT_S = 120


def kept_by_page(
    server: PageServer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> dict[str, Any]:
    """Serve a page to Chromium until its script fetches `kept?JSON`; returns that object.

    folder: for the browser's profile.
    """
    kept: dict[str, Any] = {}
    has_kept = threading.Event()
    answer_of_page = server.answer

    def answer(path: str) -> Answer:
        parts = urlsplit(path)
        if parts.path != "/kept":
            return answer_of_page(path)
        kept.update(json.loads(unquote(parts.query)))
        has_kept.set()
        return json_answer({})

    monkeypatch.setattr(server, "answer", answer)
    profile = f"--user-data-dir={folder / 'profile'}"
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", profile)
    # A port to be debugged by keeps it open.
    command = [str(CHROMIUM), *flags, "--remote-debugging-port=0", server.url]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as browser:
        try:
            assert has_kept.wait(_LIMIT_S)
        finally:
            browser.terminate()
            server.shutdown()
    return kept
