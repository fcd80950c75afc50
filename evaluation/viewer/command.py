"""`simnfnd view PATH`: a dataset or recording in the browser, from this machine to itself alone."""

from __future__ import annotations

import tempfile
import webbrowser
from contextlib import suppress
from pathlib import Path

from ...factory.cli import Parser
from .server import Viewer
from .shown import open_shown


def main(words: list[str]) -> None:
    """Serve what `words` ask for until Ctrl-C."""
    parser = Parser(prog="simnfnd view")
    parser.add_argument("path", type=Path, help="dataset, recording, bag, video, or pictures")
    parser.add_argument("after", type=Path, nargs="?", help="the same recording, denoised")
    parser.add_argument("--port", type=int, default=0, help="of 127.0.0.1; default: a free one")
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    given = parser.parse_args(words)
    with (
        Viewer(open_shown(given.path, given.after), given.port) as viewer,
        tempfile.TemporaryDirectory(prefix="simnfnd-view-", ignore_cleanup_errors=True) as folder,
    ):
        print(f"view: {viewer.url} (Ctrl-C ends)", flush=True)
        if not given.no_browser:
            # Every user can read the words of a browser's process: a file of ours has the address.
            page = Path(folder, "open.html")
            page.write_text(f'<meta http-equiv="refresh" content="0; url={viewer.url}">')
            webbrowser.open(page.as_uri())
        with suppress(KeyboardInterrupt):
            viewer.serve_forever()
        print()
