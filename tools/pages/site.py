"""Hooks of mkdocs: pages that are written from the code, and links out of `docs`.

mkdocs.yml names this file.  With `--strict`, a link to a page, heading or file that is not there
fails the build.
"""

from __future__ import annotations

import posixpath
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

# File of the checkout -> the page that shows it.
SHOWN = {
    "README.md": "index.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CODE_OF_CONDUCT.md": "project/code-of-conduct.md",
    "SECURITY.md": "project/security.md",
    "models/pretrained/simnfnd.md": "reference/weights-simnfnd.md",
    "models/pretrained/simnfnd-fast.md": "reference/weights-simnfnd-fast.md",
    "models/pretrained/simnfnd-recordings.md": "reference/weights-simnfnd-recordings.md",
    "models/pretrained/simnfnd-removal.md": "reference/weights-simnfnd-removal.md",
    "models/pretrained/simnfnd-paper.md": "reference/weights-simnfnd-paper.md",
    "examples/didson/NOTICE.md": "project/lamprey-notice.md",
    "examples/load_with_workers.py": "reference/load_with_workers.py",
    "examples/read_with_h5py.py": "reference/read_with_h5py.py",
    "examples/train_a_tiny_network.py": "reference/train_a_tiny_network.py",
    "examples/ros2_denoise.py": "reference/ros2_denoise.py",
    "examples/onnx_denoise.py": "reference/onnx_denoise.py",
    "examples/point_cloud.py": "reference/point_cloud.py",
    "examples/boxes.py": "reference/boxes.py",
    "examples/complex_field.py": "reference/complex_field.py",
    "conf/noise/physical.yaml": "reference/physical.yaml",
    "LICENSE": "project/LICENSE.txt",
    "CITATION.cff": "project/CITATION.cff",
}
_LINK = re.compile(r"(\]\()([^)\s]+)(\))")
_FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that no file of `docs` holds."""
    from tools.pages import commands_page, keys_page, notebooks, python_page

    written: dict[str, Callable[[], str]] = {
        "reference/commands.md": commands_page.markdown,
        "reference/keys.md": keys_page.markdown,
        "reference/python.md": python_page.markdown,
    }
    for name, write in written.items():
        files.append(File.generated(config, name, content=write()))
    for source, name in SHOWN.items():
        if name != "index.md":
            text = (ROOT / source).read_text(encoding="utf-8")
            files.append(File.generated(config, name, content=text))
    for notebook in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        stem = notebook.stem
        text, pictures = notebooks.markdown(notebook.read_text(encoding="utf-8"), stem)
        files.append(File.generated(config, f"notebooks/{stem}.md", content=text))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Make links to files of the checkout links to the pages that show them."""
    place = page.file.src_uri
    sources = {shown: source for source, shown in SHOWN.items() if shown != "index.md"}
    # Where a shown file stands in the checkout: its links start there.
    origin = sources.get(place, f"docs/{place}")

    def mended(match: re.Match[str]) -> str:
        target, _, anchor = match.group(2).partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return match.group(0)
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
        if wanted in SHOWN:
            found = SHOWN[wanted]
        elif wanted.startswith("docs/"):
            found = wanted.removeprefix("docs/")
        elif (ROOT / wanted).exists():
            raise PluginError(f"{origin}: links to {wanted}, which no page shows (SHOWN, site.py)")
        else:
            return match.group(0)
        link = posixpath.relpath(found, posixpath.dirname(place) or ".")
        return f"{match.group(1)}{link}{'#' * bool(anchor)}{anchor}{match.group(3)}"

    # Code shows what it shows.
    parts, last = [], 0
    for fence in _FENCE.finditer(markdown):
        parts += [_LINK.sub(mended, markdown[last : fence.start()]), fence.group(0)]
        last = fence.end()
    return "".join([*parts, _LINK.sub(mended, markdown[last:])])
