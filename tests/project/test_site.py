"""The docs site: it builds without a warning, loads nothing from elsewhere, and misses nothing."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import pytest

import simnfnd
from simnfnd.verbs import VERBS
from tests.project_files import ROOT
from tools.site import notebook_page

# What a browser loads with a page, as against what a reader may follow.
_LOADED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=\"?([^\"\s>]+)")


def build(folder: Path, target: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(target)],
        cwd=folder,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `make docs` builds it."""
    target = tmp_path_factory.mktemp("site")
    done = build(ROOT, target)
    assert done.returncode == 0, done.stdout[-4000:]
    assert "WARNING" not in done.stdout
    return target


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        text = page.read_text(encoding="utf-8")
        for loaded in _LOADED.findall(text):
            assert "//" not in loaded, f"{page.relative_to(site)} loads {loaded}"
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(@import|url\()\s*[\"']?(https?:)?//", text), sheet.name


@pytest.mark.slow
def test_what_pages_load_and_link_to_is_there(site: Path) -> None:
    """mkdocs sees links of Markdown; this sees those of the theme and of HTML, too."""
    link = re.compile(r"\b(?:src|href)=\"([^\"#?]+)")
    for page in site.rglob("*.html"):
        if page.name == "404.html":
            continue  # its links are those of a server's root
        for target in link.findall(page.read_text(encoding="utf-8")):
            if not re.match(r"[a-z]+:", target):
                place = page.parent / unquote(unescape(target))
                assert place.exists(), f"{page.relative_to(site)} links to {target}"


@pytest.mark.slow
def test_every_page_verb_key_and_name_is_shown(site: Path) -> None:
    for source in (ROOT / "docs").rglob("*.md"):
        assert (site / source.relative_to(ROOT / "docs")).with_suffix(".html").is_file()
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    names = [*VERBS, *(f"{name} {own}" for name, verb in VERBS.items() for own in verb.verbs)]
    for name in names:
        assert f'id="{name.replace(" ", "-")}"' in commands, name
    assert "--remove LIST" in commands
    python = (site / "reference" / "python.html").read_text(encoding="utf-8")
    for name in set(simnfnd.__all__) - {"__version__"}:
        assert f'.{name}"' in python, name
    keys = (site / "reference" / "keys.html").read_text(encoding="utf-8")
    for file in (ROOT / "conf").rglob("*.yaml"):
        name = file.relative_to(ROOT / "conf").with_suffix("").as_posix()
        assert f'id="{name.replace("/", "")}"' in keys, name


# The machinery, on texts of our own.


def test_a_notebook_as_a_page() -> None:
    text = """{"cells": [
      {"cell_type": "markdown", "source": ["# Title"]},
      {"cell_type": "code", "source": ["1 + 1"], "outputs": [
        {"output_type": "execute_result", "data": {"text/plain": ["2"]}},
        {"output_type": "display_data", "data": {"image/png": "UE5H"}}]}]}"""
    page, pictures = notebook_page(text, "x")
    assert page.startswith("# Title\n\n```python\n1 + 1\n```\n\n```text\n2\n```")
    assert pictures == {"x-1.png": b"PNG"}
    with pytest.raises(ValueError, match="text/html"):
        notebook_page(text.replace("text/plain", "text/html"), "x")


@pytest.mark.slow
def test_a_broken_link_fails_the_build(tmp_path: Path) -> None:
    """In a site of one page and what it needs: without the pages that the code writes."""
    for name in ("docs/images", "tools/pages"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("docs/method.md", "mkdocs.yml", "tools/site.py"):
        shutil.copy(ROOT / name, tmp_path / name)
    hooks = (tmp_path / "tools/site.py").read_text(encoding="utf-8")
    hooks = hooks.replace("def on_files(", "def not_now(")
    (tmp_path / "tools/site.py").write_text(hooks, encoding="utf-8")
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    head = settings.split("\nnot_in_nav:")[0].split("\n# Shown by links")[0]
    head = re.sub(r"^theme:.*?(?=^extra:)", "theme: mkdocs\n", head, flags=re.DOTALL | re.MULTILINE)
    head = re.sub(r"^plugins:.*?(?=^hooks:)", "plugins: []\n", head, flags=re.DOTALL | re.MULTILINE)
    (tmp_path / "mkdocs.yml").write_text(head, encoding="utf-8")
    (tmp_path / "docs" / "method.md").write_text("# Method\n", encoding="utf-8")

    def built(text: str) -> subprocess.CompletedProcess[str]:
        (tmp_path / "docs" / "index.md").write_text(f"# Start\n\n{text}\n", encoding="utf-8")
        return build(tmp_path, tmp_path / "site")

    done = built("[a](method.md) [no](gone.md) [nor](method.md#gone) ![nor this](images/gone.png)")
    assert done.returncode == 1
    for gone in ("gone.md", "method.md#gone", "images/gone.png"):
        assert gone in done.stdout
    done = built("[a file that no page shows](../mkdocs.yml)")
    assert done.returncode == 1
    assert "links to mkdocs.yml" in done.stdout
