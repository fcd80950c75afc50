"""`simnfnd view` and `simnfnd preview`: datasets and recordings, in the browser or on a sheet."""

from __future__ import annotations

import tempfile
import webbrowser
from contextlib import closing, suppress
from pathlib import Path

from ...factory.cli import Parser
from ...factory.dataset.preview import Shown, draw, preview
from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...models.recordings import is_recording
from ..metrics.statistics import evenly
from .server import Viewer
from .shown import ShownRecording, open_shown


def view(words: list[str]) -> None:
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


def sheet(words: list[str]) -> None:
    """Draw the contact sheet that `words` ask for."""
    parser = Parser(prog="simnfnd preview")
    parser.add_argument("dir", type=Path, help="folder of a dataset, or a recording")
    parser.add_argument(
        "--out", type=Path, help="picture to write (default: DIR/preview.png; a recording needs it)"
    )
    parser.add_argument("--pairs", type=int, default=8, help="pairs or frames to show")
    given = parser.parse_args(words)
    if is_recording(given.dir):
        path = _of_recording(given.dir, given.out, given.pairs)
    else:
        path = preview(given.dir, out=given.out, pairs=given.pairs)
    print(f"preview: {path}")


def _of_recording(source: Path, out: Path | None, frames: int) -> Path:
    """Draw frames, evenly spread, pings as fans; returns the path."""
    if out is None:
        raise FactoryError(f"{source}: a recording has no folder of its own; give --out FILE.png")
    if frames < 1:
        raise FactoryError(f"--pairs must be at least 1, got {frames}")
    shown = []
    with closing(ShownRecording(source)) as recording:
        count = len(recording)
        for number in evenly(range(count), frames):
            picture = recording.picture(number, 0)
            grey = picture.mean(axis=-1) if picture.ndim == 3 else picture
            shown.append(Shown(f"frame {number}", {"picture": grey}, 255.0))
    write_atomically(out, draw(shown, source.name, f"{count} frames"), key="--out")
    return out
