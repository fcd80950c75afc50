"""The docs site: it builds without a warning, loads nothing from elsewhere, and misses nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import pytest

import simnfnd
from simnfnd.verbs import VERBS
from tests.project_files import ROOT

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
    assert "--frames N" in commands
    python = (site / "reference" / "python.html").read_text(encoding="utf-8")
    for name in set(simnfnd.__all__) - {"__version__"}:
        assert f'.{name}"' in python, name
    keys = (site / "reference" / "keys.html").read_text(encoding="utf-8")
    for file in (ROOT / "conf").rglob("*.yaml"):
        name = file.relative_to(ROOT / "conf").with_suffix("").as_posix()
        assert f'id="{name.replace("/", "")}"' in keys, name
