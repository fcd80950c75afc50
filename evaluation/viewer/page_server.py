"""A page on this machine for whoever started it: `simnfnd view` and `simnfnd lab` serve theirs."""

from __future__ import annotations

import json
import secrets
import socket
import sys
import tempfile
import threading
import traceback
import webbrowser
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError

ADDRESS = "127.0.0.1"
_CONTENT_POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; script-src 'self' 'unsafe-inline'"
)

# How long a request waits for the one before it.
_PATIENCE_S = 60.0


class Answer(NamedTuple):
    """What a request gets: its MIME type and its bytes."""

    mime_type: str
    content: bytes


def json_answer(value: Any) -> Answer:
    """Plain values as JSON."""
    return Answer("application/json", json.dumps(value).encode())


class UnknownPath(LookupError):
    """Nothing is at this path."""


class PageServer(ThreadingHTTPServer):
    """Serves a page until it is shut down; a subclass says what each path holds.

    verb: of `simnfnd`; begins what is printed.
    url: where; it holds a random token, without which other users of the machine get nothing.
    hosts: names by which a browser may call this server.  A foreign page whose own name was bound
        to this address (DNS rebinding) calls it by that name, and is refused.
    """

    verb = "page"
    daemon_threads = True
    request_queue_size = 256
    """Connections that wait to be accepted: a page may ask for many images at once."""

    def __init__(self, port: int = 0) -> None:
        """port: 0 takes a free one.  Raises FactoryError when it is taken."""
        try:
            super().__init__((ADDRESS, port), _Handler)
        except (OSError, OverflowError) as error:
            raise FactoryError(f"--port {port}: cannot be used ({error})") from error
        # Requests are answered by one thread at a time.
        self.lock = threading.Lock()
        self.token = secrets.token_urlsafe(24)
        self.url = f"http://{ADDRESS}:{self.server_port}/{self.token}/"
        self.hosts = {f"{name}:{self.server_port}" for name in (ADDRESS, "localhost")}

    def answer(self, path: str) -> Answer:
        """What a path below `url` holds, with its leading slash and its query.

        Raises UnknownPath, and FactoryError with a line for the page to show.
        """
        raise NotImplementedError

    def serve_until_interrupted(self, *, opens_browser: bool) -> None:
        """Print the address, open it in the browser, and serve until Ctrl-C."""
        prefix = f"simnfnd-{self.verb}-"
        with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as folder:
            print(f"{self.verb}: {self.url} (Ctrl-C ends)", flush=True)
            if opens_browser:
                # Every user of the machine can read the command line of a browser, but not a file
                # of ours: the address stands in a file.
                page = Path(folder, "open.html")
                page.write_text(f'<meta http-equiv="refresh" content="0; url={self.url}">')
                webbrowser.open(page.as_uri())
            with suppress(KeyboardInterrupt):
                self.serve_forever()
            print()

    def handle_error(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any
    ) -> None:
        """Nothing of a browser that went away; one line of anything else."""
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError | TimeoutError):
            print(f"{self.verb}: {type(error).__name__}: {error}", file=sys.stderr)


def add_page_options(parser: Parser) -> None:
    """The options of every verb that serves a page."""
    parser.add_argument(
        "--port", type=int, default=0, help="port of 127.0.0.1 (default: a free one)"
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address")


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 10.0
    """Seconds that a connection may say nothing."""

    def do_GET(self) -> None:
        refusal = f"open the address that `simnfnd {self.server.verb}` printed".encode()
        if self.headers.get("Host") not in self.server.hosts:
            self._send(403, "text/plain", refusal)
            return
        token, slash, path = self.path.removeprefix("/").partition("/")
        # In bytes, because a path may have any letters.
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self._send(403, "text/plain", refusal)
            return
        if not self.server.lock.acquire(timeout=_PATIENCE_S):
            self._send_error("an earlier request is still being answered; wait, or start again")
            return
        try:
            answer = self.server.answer(slash + path)
        except UnknownPath:
            self._send(404, "text/plain", b"not found")
        except FactoryError as error:
            self._send_error(str(error))
        except Exception as error:
            # A defect: the page says so, and the terminal where.
            traceback.print_exc()
            self._send_error(f"{type(error).__name__}: {error}")
        else:
            self._send(200, *answer)
        finally:
            self.server.lock.release()

    def _send_error(self, line: str) -> None:
        text = " ".join(line.split()).encode(errors="replace")
        self._send(500, "text/plain; charset=utf-8", text)

    def _send(self, code: int, mime_type: str, content: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Type", mime_type)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Content-Security-Policy", _CONTENT_POLICY)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Nothing: the terminal is the user's."""
