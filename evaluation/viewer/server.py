"""The page and what it asks for, over HTTP on loopback."""

from __future__ import annotations

import io
import json
import re
import secrets
import socket
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from PIL import Image

from ...factory.errors import FactoryError
from .shown import Shown

ADDRESS = "127.0.0.1"
_PAGE = Path(__file__).with_name("page.html")
_ASKED = re.compile(r"/(?:picture|facts)/(\d{1,12})(?:/(\d{1,3})\.png|\.json)")


class Viewer(ThreadingHTTPServer):
    """Serves what is shown until it is shut down.

    url: where; it holds a random token, without which other users of the machine get nothing.
    """

    daemon_threads = True

    def __init__(self, shown: Shown, port: int = 0) -> None:
        """port: 0 takes a free one.  Raises FactoryError when it is taken."""
        try:
            super().__init__((ADDRESS, port), _Handler)
        except (OSError, OverflowError) as error:
            raise FactoryError(f"--port {port}: cannot be used ({error})") from error
        self.shown = shown
        # Files are read by one thread at a time.
        self.lock = threading.Lock()
        self.token = secrets.token_urlsafe(24)
        self.url = f"http://{ADDRESS}:{self.server_port}/{self.token}/"

    def handle_error(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any
    ) -> None:
        """Nothing of a browser that went away; one line of anything else."""
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError | TimeoutError):
            print(f"view: {type(error).__name__}: {error}", file=sys.stderr)


class _Handler(BaseHTTPRequestHandler):
    server: Viewer

    def do_GET(self) -> None:
        # A page of somebody else whose name was made to point here sends its own name.
        if self.headers.get("Host") not in (
            f"{ADDRESS}:{self.server.server_port}",
            f"localhost:{self.server.server_port}",
        ):
            self._send(403, "text/plain", b"not for other names")
            return
        token, slash, wanted = self.path.removeprefix("/").partition("/")
        # In bytes, because a path may have any letters.
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self._send(403, "text/plain", b"open the address that `simnfnd view` printed")
            return
        try:
            with self.server.lock:
                kind, content = self._answer(slash + wanted)
            self._send(200, kind, content)
        except LookupError:
            self._send(404, "text/plain", b"not found")
        except FactoryError as error:
            self._send(500, "text/plain; charset=utf-8", str(error).encode())

    def _answer(self, path: str) -> tuple[str, bytes]:
        shown = self.server.shown
        if path == "/":
            return "text/html; charset=utf-8", _PAGE.read_bytes()
        if path == "/about.json":
            return _json({"title": shown.title, "layers": shown.layers, "count": len(shown)})
        found = _ASKED.fullmatch(path)
        number, layer = (int(one or 0) for one in found.groups()) if found else (len(shown), 0)
        if number >= len(shown) or layer >= len(shown.layers):
            raise LookupError
        if path.startswith("/facts"):
            return _json(shown.facts(number))
        buffer = io.BytesIO()
        Image.fromarray(shown.picture(number, layer)).save(buffer, "PNG", compress_level=1)
        return "image/png", buffer.getvalue()

    def _send(self, code: int, kind: str, content: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        own = "default-src 'self'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
        self.send_header("Content-Security-Policy", own)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Nothing: the terminal is the user's."""


def _json(value: Any) -> tuple[str, bytes]:
    return "application/json", json.dumps(value).encode()
