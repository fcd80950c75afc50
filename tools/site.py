"""Hooks of mkdocs: pages that the code writes, and links out of `docs`.

mkdocs.yml names this file.  With `--strict`, a link to a page, heading or file that is not there
fails the build.  The Python page is mkdocstrings' work (docs/reference/python.md).
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import posixpath
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

# File of the checkout -> the page that shows it.
SHOWN = {
    "README.md": "index.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CODE_OF_CONDUCT.md": "project/code-of-conduct.md",
    "SECURITY.md": "project/security.md",
    "examples/didson/NOTICE.md": "project/lamprey-notice.md",
    "LICENSE": "project/LICENSE.txt",
    "CITATION.cff": "project/CITATION.cff",
} | {
    card.relative_to(ROOT).as_posix(): f"reference/weights-{card.name}"
    for folder in ("pretrained", "detection")
    for card in sorted((ROOT / "models" / folder).glob("*.md"))
} | {
    f"examples/{script.name}": f"reference/{script.name}"
    for script in sorted((ROOT / "examples").iterdir())
    if script.suffix in (".py", ".cpp")
} | {
    path.relative_to(ROOT).as_posix(): f"reference/{path.relative_to(ROOT).as_posix()}"
    for path in sorted((ROOT / "conf").rglob("*.yaml"))
}  # fmt: skip
# Where a checkout has what a page is written from -> that page.
WRITTEN = {"simnfnd/verbs.py": "reference/commands.md", "conf": "reference/keys.md"}
_LINK = re.compile(r"(\]\()([^)\s]+)(\))")
_FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that no file of `docs` holds."""
    written: dict[str, Callable[[], str]] = {
        "reference/commands.md": commands_page,
        "reference/keys.md": keys_page,
    }
    for name, write in written.items():
        files.append(File.generated(config, name, content=write()))
    for source, name in SHOWN.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=text))
    for notebook in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        text, images = notebook_page(notebook.read_text(encoding="utf-8"), notebook.stem)
        files.append(File.generated(config, f"notebooks/{notebook.stem}.md", content=text))
        for name, image in images.items():
            files.append(File.generated(config, f"notebooks/{name}", content=image))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turn links to files of the checkout into links to the pages that show them."""
    place = page.file.src_uri
    pages = SHOWN | WRITTEN
    sources = {shown: source for source, shown in SHOWN.items()}
    # Where a shown file stands in the checkout: its links start there.
    origin = sources.get(place, f"docs/{place}")

    def with_target(match: re.Match[str]) -> str:
        target, _, anchor = match.group(2).partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return match.group(0)
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
        if wanted in pages:
            target = pages[wanted]
        elif wanted.startswith("docs/"):
            target = wanted.removeprefix("docs/")
        elif (ROOT / wanted).exists():
            raise PluginError(f"{origin}: links to {wanted}, which no page shows (tools/site.py)")
        else:
            return match.group(0)
        link = posixpath.relpath(target, posixpath.dirname(place) or ".")
        return f"{match.group(1)}{link}{'#' * bool(anchor)}{anchor}{match.group(3)}"

    # Code blocks stay as they are.
    parts = []
    last = 0
    for fence in _FENCE.finditer(markdown):
        parts += [_LINK.sub(with_target, markdown[last : fence.start()]), fence.group(0)]
        last = fence.end()
    return "".join([*parts, _LINK.sub(with_target, markdown[last:])])


def commands_page() -> str:
    """Every verb of `simnfnd`: examples and options, as its --help prints them."""
    from simnfnd.verbs import VERBS

    lines = ["# Commands", "", "Each section is the output of `simnfnd VERB --help`.", ""]
    for name in VERBS:
        lines += [f"## {name}", "", "```text", help_of(name), "```", ""]
    return "\n".join(lines)


def help_of(name: str) -> str:
    """What `simnfnd NAME --help` prints, 80 columns wide."""
    from simnfnd.command import main

    printed = io.StringIO()
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "80"
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*name.split(), "--help"])
    os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)
    return printed.getvalue().strip()


def keys_page() -> str:
    """Every configuration file with its comments, which explain each key."""
    lines = [
        "# All configuration keys",
        "",
        "The files of `conf/`: `scenes=flsea` chooses `conf/scenes/flsea.yaml`, and",
        "`scenes.root=DIR` sets a key in it. Any number may be a distribution where its comment",
        "says so ([Configuration](../configuration.md)).",
        "",
    ]
    for path in sorted((ROOT / "conf").rglob("*.yaml")):
        name = path.relative_to(ROOT / "conf").with_suffix("").as_posix()
        text = path.read_text(encoding="utf-8").strip()
        lines += [f"## {name}", "", "```yaml", text, "```", ""]
    return "\n".join(lines)


def notebook_page(text: str, stem: str) -> tuple[str, dict[str, bytes]]:
    """The page of a notebook (its JSON as `text`), and its images by file name.

    Raises ValueError for an output that is neither text nor a PNG image.
    """
    lines: list[str] = []
    images: dict[str, bytes] = {}
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines += [source, ""]
            continue
        lines += ["```python", source, "```", ""]
        for output in cell["outputs"]:
            lines += _output(output, stem, images)
    return "\n".join(lines), images


def _output(output: dict[str, Any], stem: str, images: dict[str, bytes]) -> Iterator[str]:
    data = output.get("data", {})
    if output["output_type"] == "stream":
        yield from ("```text", "".join(output["text"]).rstrip(), "```", "")
    elif "image/png" in data:
        name = f"{stem}-{len(images) + 1}.png"
        images[name] = base64.b64decode(data["image/png"])
        yield from (f"![What the cell draws]({name})", "")
    elif "text/plain" in data:
        yield from ("```text", "".join(data["text/plain"]), "```", "")
    else:
        raise ValueError(f"{stem}.ipynb: an output of {sorted(data) or output['output_type']}")
