"""The figures of README.md are those that its commands gave, with the denoiser that ships."""

from __future__ import annotations

import json
import re

import pytest
import yaml

from tests.project_files import ROOT
from tools import readme_figures

WITHIN_DB = 0.1


def test_readme_has_the_figures_that_its_commands_gave() -> None:
    content = json.loads(readme_figures.FIGURES.read_text(encoding="utf-8"))
    readme = readme_figures.README.read_text(encoding="utf-8")
    lines = readme_figures.lines_of(content["figures"])
    assert readme_figures.with_lines(readme, lines) == readme, "run python -m tools.readme_figures"
    assert readme_figures.MARKS[0] in readme
    assert content["commands"] == readme_figures.COMMANDS
    assert all(f"`{command}`" in readme for command in readme_figures.COMMANDS.values())


def test_the_paper_has_the_same_figures_and_at_most_a_thousand_words() -> None:
    content = json.loads(readme_figures.FIGURES.read_text(encoding="utf-8"))
    paper = readme_figures.PAPER.read_text(encoding="utf-8")
    lines = readme_figures.without_links(readme_figures.lines_of(content["figures"]))
    assert readme_figures.with_lines(paper, lines) == paper, "run python -m tools.readme_figures"
    assert readme_figures.MARKS[0] in paper
    assert all(f"`{command}`" in paper for command in readme_figures.COMMANDS.values())
    _, front_matter, body = paper.split("---\n", 2)
    assert len(body.split()) <= 1000
    assert yaml.safe_load(front_matter)["bibliography"] == "paper.bib"
    entries = re.findall(
        r"^@\w+\{(\w+),", (readme_figures.PAPER.parent / "paper.bib").read_text(), re.M
    )
    cited = set(re.findall(r"@(\w+)", body))
    assert cited == set(entries)


def test_the_other_figures_are_those_of_their_tables() -> None:
    lines = readme_figures.README.read_text(encoding="utf-8").splitlines()
    (alone,) = (line for line in lines if line.startswith("- **Simulation alone**"))
    for label in ("`simulation`, longer", "`recordings`", "best filter"):
        groups_db, lamprey_db = figures("docs/models.md", "| | steps | MDD | lamprey2 |", label)
        assert re.search(rf"\b{groups_db}\b.* {lamprey_db} dB", alone)

    (speed,) = (line for line in lines if line.startswith("- **Speed**"))
    heading = "| | CPU s | times less | three runs |"
    median_times_less = figures("docs/speed.md", heading, "FLSea, closed form, cold")[-1]
    assert f"about {round(float(median_times_less), -1):.0f} times" in speed

    for name in ("simnfnd", "simnfnd-paper"):
        size_mb = (ROOT / f"models/pretrained/{name}.safetensors").stat().st_size / 1e6
        assert f"`{name}` ({size_mb:.1f} MB)" in "\n".join(lines)


def figures(page: str, heading: str, label: str) -> list[str]:
    """The last two figures of a row of the table under a heading; of a cell the first."""
    text = (ROOT / page).read_text(encoding="utf-8")
    table = text.split(f"\n{heading}\n")[1].split("\n\n")[0]
    (row,) = re.findall(rf"^\| {re.escape(label)} \|(.*)\|$", table, re.M)
    cells = [cell.split("(")[0].split("/")[0].strip() for cell in row.split("|")]
    return [cell for cell in cells if re.fullmatch(r"\d*\.\d+|\d+", cell)][-2:]


def test_the_paper_says_how_far_the_network_leads_single_frames() -> None:
    figures = json.loads(readme_figures.FIGURES.read_text(encoding="utf-8"))["figures"]
    lead_db = [
        figures[name]["simnfnd"]["psnr_db"] - figures[name][figures[name]["best"]]["psnr_db"]
        for name in ("groups", "real")
    ]
    paper = readme_figures.PAPER.read_text(encoding="utf-8")
    assert f"by {lead_db[0]:.2f} dB (ARIS) and {lead_db[1]:.2f} dB (DIDSON)" in paper


def test_the_denoiser_is_the_one_that_was_measured() -> None:
    content = json.loads(readme_figures.FIGURES.read_text(encoding="utf-8"))
    remaining = content["figures"]["probe"]
    now = readme_figures.probe()
    assert now == pytest.approx(remaining, abs=WITHIN_DB), "run python -m tools.readme_figures"


def test_other_figures_give_other_lines() -> None:
    content = json.loads(readme_figures.FIGURES.read_text(encoding="utf-8"))["figures"]
    before = readme_figures.lines_of(content)
    content["real"]["moving"]["simnfnd: fused and denoised"]["psnr_db"] = 12.34
    content["detect"]["simnfnd, 7 frames"]["auc"] = 0.567
    after = readme_figures.lines_of(content)
    assert "12.34 dB" in after
    assert "12.34 dB" not in before
    assert "0.567" in after
    first, last = readme_figures.MARKS
    page = f"a\n{first}\nold\n{last}\nb"
    assert readme_figures.with_lines(page, "new\n") == f"a\n{first}\nnew\n{last}\nb"
