"""`simnfnd view PATH`: a dataset or recording in the browser, from this machine to itself alone."""

from __future__ import annotations

import webbrowser
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
    with Viewer(open_shown(given.path, given.after), given.port) as viewer:
        print(f"view: {viewer.url} (Ctrl-C ends)", flush=True)
        if not given.no_browser:
            webbrowser.open(viewer.url)
        try:
            viewer.serve_forever()
        except KeyboardInterrupt:
            print()
