"""The figures of README.md are those that its commands gave, with the denoiser that ships."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
import yaml

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


def test_readme_and_paper_name_the_commands() -> None:
    for page in (readme_figures.README, readme_figures.PAPER):
        text = page.read_text(encoding="utf-8")
        assert all(f"`{command}`" in text for command in readme_figures.COMMANDS.values())


def test_the_paper_has_at_most_a_thousand_words_and_cites_what_it_lists() -> None:
    paper = readme_figures.PAPER.read_text(encoding="utf-8")
    _, front_matter, body = paper.split("---\n", 2)
    assert len(body.split()) <= 1000
    assert yaml.safe_load(front_matter)["bibliography"] == "paper.bib"
    entries = re.findall(
        r"^@\w+\{(\w+),", (readme_figures.PAPER.parent / "paper.bib").read_text(), re.M
    )
    cited = set(re.findall(r"@(\w+)", body))
    assert cited == set(entries)


def test_the_sizes_of_the_weights_are_those_of_the_files() -> None:
    page = (ROOT / "docs/how-to/recordings.md").read_text(encoding="utf-8")
    for name in ("simnfnd", "simnfnd-paper"):
        size_mb = (ROOT / f"models/pretrained/{name}.safetensors").stat().st_size / 1e6
        assert f"`{name}` ({size_mb:.1f} MB)" in page


def test_the_paper_says_how_far_the_network_leads_single_frames() -> None:
    figures = kept()
    lead_db = [
        figures[name]["simnfnd"]["psnr_db"] - figures[name][figures[name]["best"]]["psnr_db"]
        for name in ("groups", "real")
    ]
    paper = readme_figures.PAPER.read_text(encoding="utf-8")
    assert f"by {lead_db[0]:.2f} dB (ARIS) and {lead_db[1]:.2f} dB (DIDSON)" in paper


@pytest.mark.slow
def test_the_denoiser_is_the_one_that_was_measured() -> None:
    now = readme_figures.probe()
    assert now == pytest.approx(kept()["probe"], abs=WITHIN_DB), (
        "run python -m tools.readme_figures"
    )


def test_other_figures_give_other_tables() -> None:
    figures = kept()
    before = readme_figures.tables(figures)
    figures["real"]["moving"]["simnfnd: fused and denoised"]["psnr_db"] = 12.34
    figures["detect"]["simnfnd, 7 frames"]["contrast"] = 0.123
    after = readme_figures.tables(figures)
    for page in (readme_figures.README, readme_figures.PAPER, readme_figures.RECORDINGS):
        assert "12.34 dB" in after[page]
        assert "12.34 dB" not in before[page]
    for page in (readme_figures.README, readme_figures.EVALUATION):
        assert "| 12 % |" in after[page]
        assert "| 12 % |" not in before[page]


def test_lines_replace_what_stands_between_the_marks() -> None:
    first, last = readme_figures.MARKS
    page = f"a\n{first}\nold\n{last}\nb"
    assert readme_figures.with_lines(page, "new\n") == f"a\n{first}\nnew\n{last}\nb"
    assert readme_figures.without_links("[a](b.md#c): `x[1]` (d)") == "a: `x[1]` (d)"
