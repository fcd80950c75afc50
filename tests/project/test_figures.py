"""The figures of README.md are those that its commands gave, with the denoiser that ships."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.project_files import ROOT
from tools import readme_figures

WITHIN_DB = 0.1


def kept() -> dict[str, Any]:
    content = json.loads(readme_figures.FIGURES.read_text(encoding="utf-8"))
    assert content["commands"] == readme_figures.COMMANDS
    return dict(content["figures"])


def test_pages_have_the_figures_that_the_commands_gave() -> None:
    for page, table in readme_figures.tables(kept()).items():
        text = page.read_text(encoding="utf-8")
        assert readme_figures.MARKS[0] in text
        assert readme_figures.with_lines(text, table) == text, "run python -m tools.readme_figures"


def test_the_sizes_of_the_weights_are_those_of_the_files() -> None:
    page = (ROOT / "docs/how-to/recordings.md").read_text(encoding="utf-8")
    for name in ("simnfnd", "simnfnd-paper"):
        size_mb = (ROOT / f"models/pretrained/{name}.safetensors").stat().st_size / 1e6
        assert f"`{name}` ({size_mb:.1f} MB)" in page


@pytest.mark.slow
def test_the_denoiser_is_the_one_that_was_measured() -> None:
    now = readme_figures.probe()
    assert now == pytest.approx(kept()["probe"], abs=WITHIN_DB), (
        "run python -m tools.readme_figures"
    )
