"""The docs site builds, loads nothing from elsewhere and misses nothing; the notebooks run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html import unescape
from itertools import groupby
from pathlib import Path
from urllib.parse import unquote

import nbformat
import pytest

import simnfnd
from simnfnd.verbs import VERBS
from tests.project_files import ROOT
from tools.notebooks import FOLDER, executed

# What a browser loads with a page, as against what a reader may follow.
_LOADED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=\"?([^\"\s>]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `make docs` builds it."""
    target = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(target)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    assert "WARNING" not in done.stdout
    return target


@pytest.mark.slow
def test_what_pages_load_and_link_to_is_there(site: Path) -> None:
    """mkdocs sees links of Markdown; this sees those of the theme and of HTML, too."""
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    link = re.compile(r"\b(?:src|href)=\"([^\"#?]+)")
    for page in pages:
        text = page.read_text(encoding="utf-8")
        name = page.relative_to(site)
        assert not [source for source in _LOADED.findall(text) if "//" in source], (
            f"{name} loads it"
        )
        for target in link.findall(text) if page.name != "404.html" else ():  # a server's root
            if not re.match(r"[a-z]+:", target):
                place = page.parent / unquote(unescape(target))
                assert place.exists(), f"{name} links to {target}"
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(@import|url\()\s*[\"']?(https?:)?//", text), sheet.name


@pytest.mark.slow
def test_every_page_verb_key_and_name_is_shown(site: Path) -> None:
    for source in (ROOT / "docs").rglob("*.md"):
        assert (site / source.relative_to(ROOT / "docs")).with_suffix(".html").is_file()
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    for name in VERBS:
        assert f'id="{name.replace(" ", "-")}"' in commands, name
    assert "--frames N" in commands
    python = (site / "reference" / "python.html").read_text(encoding="utf-8")
    for name in set(simnfnd.__all__) - {"__version__"}:
        assert f'.{name}"' in python, name
    keys = (site / "reference" / "keys.html").read_text(encoding="utf-8")
    for file in (ROOT / "conf").rglob("*.yaml"):
        name = file.relative_to(ROOT / "conf").with_suffix("").as_posix()
        assert f'id="{name.replace("/", "")}"' in keys, name


def test_links_of_the_docs_are_there_in_a_checkout() -> None:
    link = re.compile(r"\]\(([^)\s#]+)")
    fence = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    assert len(pages) > 40
    for page in pages:
        text = fence.sub("", page.read_text(encoding="utf-8"))
        targets = [target for target in link.findall(text) if not re.match(r"[a-z]+:", target)]
        missing = [target for target in targets if not (page.parent / target).exists()]
        assert missing == [], page


def shown(document: nbformat.NotebookNode) -> list[list[str]]:
    """For each cell of code: what kinds of things it shows; text may come in pieces."""
    code = [cell for cell in document.cells if cell.cell_type == "code"]
    kinds = [[o.get("name") or "+".join(o.get("data", {})) for o in cell.outputs] for cell in code]
    return [[kind for kind, _ in groupby(kinds_of_page)] for kinds_of_page in kinds]


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_stored(notebook: Path, tmp_path: Path) -> None:
    stored = nbformat.read(notebook, as_version=4)
    assert notebook.stat().st_size < 300_000
    assert {kind for cell in shown(stored) for kind in cell} == {"stdout", "image/png"}
    assert shown(executed(notebook, tmp_path)) == shown(stored), (
        f"run `python -m tools.notebooks {notebook.stem}`"
    )
