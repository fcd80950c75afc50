"""`--push`, against a hub of our own on loopback."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from simnfnd.factory.commands.export import main
from simnfnd.factory.errors import FactoryError
from tests.factory.export.export_dataset import write
from tests.project_files import ROOT


class Hub(ThreadingHTTPServer):
    """The calls of the hub that an upload makes; keeps what it was sent."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.url = f"http://127.0.0.1:{self.server_port}"
        self.created: dict[str, Any] = {}
        self.files: dict[str, bytes] = {}


class _Handler(BaseHTTPRequestHandler):
    server: Hub

    def do_GET(self) -> None:
        self._answer({"name": "me", "type": "user"} if self.path == "/api/whoami-v2" else None)

    def do_POST(self) -> None:
        body = self._body()
        path = urlsplit(self.path).path
        if path == "/api/repos/create":
            self.server.created = json.loads(body)
            self._answer({"url": f"{self.server.url}/datasets/me/pairs", "name": "me/pairs"})
        elif path == "/api/validate-yaml":
            self._answer({"errors": [], "warnings": []})
        elif path == "/api/datasets/me/pairs/preupload/main":
            names = [one["path"] for one in json.loads(body)["files"]]
            regular = {"uploadMode": "regular", "shouldIgnore": False}
            self._answer({"files": [{"path": name, **regular} for name in names]})
        elif path == "/api/datasets/me/pairs/commit/main":
            for line in body.splitlines():
                entry = json.loads(line)
                if entry["key"] == "file":
                    content = base64.b64decode(entry["value"]["content"])
                    self.server.files[entry["value"]["path"]] = content
            commit = "0" * 40
            url = f"{self.server.url}/datasets/me/pairs/commit/{commit}"
            self._answer({"success": True, "commitOid": commit, "commitUrl": url})
        else:
            self._answer(None)

    def _body(self) -> bytes:
        if "content-length" in self.headers:
            return self.rfile.read(int(self.headers["content-length"]))
        parts = []
        while size := int(self.rfile.readline(), 16):
            parts.append(self.rfile.read(size))
            self.rfile.readline()
        self.rfile.readline()
        return b"".join(parts)

    def _answer(self, answer: Any) -> None:
        known = self.headers.get("authorization") == "Bearer hf_good"
        code = 404 if answer is None else 200 if known else 401
        content = json.dumps(answer if code == 200 else {"error": "no"}).encode()
        self.send_response(code)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def hub() -> Iterator[Hub]:
    with Hub() as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def run(folder: Path, url: str, token: str, *words: str) -> subprocess.CompletedProcess[str]:
    """In a process of its own: the library reads its surroundings when it is imported."""
    surroundings = {name: text for name, text in os.environ.items() if not name.startswith("HF_")}
    surroundings |= {"HF_ENDPOINT": url, "HF_TOKEN": token, "HF_HOME": str(folder / "hf")}
    surroundings |= {"PYTHONPATH": str(ROOT), "HF_HUB_DISABLE_TELEMETRY": "1"}
    command = [sys.executable, "-m", "simnfnd", "export", "data", "--to", "huggingface"]
    return subprocess.run(
        [*command, "--out", "out", "--push", "me/pairs", *words],
        cwd=folder,
        env=surroundings,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_the_folder_arrives_whole(tmp_path: Path, hub: Hub) -> None:
    write(tmp_path / "data")
    done = run(tmp_path, hub.url, "hf_good", "--private")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == f"hub: {hub.url}/datasets/me/pairs"
    assert (hub.created["name"], hub.created["type"]) == ("pairs", "dataset")
    assert "private" in (hub.created.get("visibility"), *hub.created)
    files = {
        path.relative_to(tmp_path / "out").as_posix(): path.read_bytes()
        for path in (tmp_path / "out").rglob("*")
        if path.is_file()
    }
    assert hub.files == files
    assert {"README.md", "data/train-00000-of-00001.parquet"} < set(files)
    assert b"license: cc-by-4.0" in files["README.md"]


def test_a_hub_that_refuses_is_said_before_the_export(tmp_path: Path, hub: Hub) -> None:
    write(tmp_path / "data")
    done = run(tmp_path, hub.url, "hf_bad")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: --push me/pairs: ")
    assert not (tmp_path / "out").exists()
    assert hub.files == hub.created == {}


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--to", "png", "--push", "me/pairs"], "--push goes with --to huggingface"),
        (["--to", "huggingface", "--push", "me/../x"], "--push me/../x: Repo id must be"),
    ],
)
def test_words_that_cannot_be(tmp_path: Path, words: list[str], why: str) -> None:
    with pytest.raises(FactoryError, match=why):
        main([str(tmp_path), "--out", str(tmp_path / "out"), *words])


def test_an_absent_library_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(FactoryError, match=r"--push needs huggingface_hub: pip install"):
        main([str(tmp_path), "--to", "huggingface", "--push", "a/b", "--out", str(tmp_path / "o")])
