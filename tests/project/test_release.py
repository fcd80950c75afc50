"""What a release needs: one version, files that say what they must, and a check of these."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from simnfnd import __version__
from tests.project_files import ROOT, project
from tools.release_check import problems


def test_citation_and_changelog_know_the_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert citation["license"] == project()["project"]["license"]
    (paper,) = citation["references"]
    assert paper["doi"] == "10.3390/rs16152815"
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.findall(r"^## (.+)$", changelog, flags=re.MULTILINE)[0]
    assert first == "Unreleased" or first.startswith(f"{__version__}, ")


def test_the_image_has_what_the_wheels_load_and_the_install_reads() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    script = (ROOT / "tools" / "debian_packages.sh").read_text(encoding="utf-8")
    for name in ("for_bpy", "for_open3d"):
        (packages,) = re.findall(rf"^{name}=\((.+)\)$", script, flags=re.MULTILINE)
        assert set(packages.split()) <= set(text.split())
    copied = {
        word for line in re.findall(r"^COPY (.+)$", text, re.MULTILINE) for word in line.split()
    }
    links = {path.name for path in (ROOT / "simnfnd").iterdir() if path.is_symlink()}
    wanted = {"pyproject.toml", "constraints.txt", "simnfnd", *links}
    wanted |= {project()["project"]["readme"], *project()["project"]["license-files"]}
    assert wanted <= copied
    assert 'ENTRYPOINT ["simnfnd"]' in text
    assert 'CMD ["demo"]' in text


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A checkout that is ready for the release 1.2.3."""
    (tmp_path / "factory").mkdir()
    (tmp_path / "factory" / "__init__.py").write_text('__version__ = "1.2.3"\n')
    (tmp_path / "CITATION.cff").write_text("version: 1.2.3\ndate-released: 2026-01-02\n")
    (tmp_path / "CHANGELOG.md").write_text(
        "# Log\n\n## Unreleased\n\n## 1.2.3, 2026-01-02\n\nNew.\n"
    )
    who = ["-c", "user.name=T", "-c", "user.email=t@t"]
    for words in (["init", "--quiet"], ["add", "."], [*who, "commit", "--quiet", "-m", "All"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    return tmp_path


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("CITATION.cff", "version: 1.2.3", "version: 1.2.2", "version is 1.2.2"),
        ("CHANGELOG.md", "## 1.2.3, 2026-01-02", "## 1.2.3", "no heading"),
        ("CHANGELOG.md", "## Unreleased\n", "## Unreleased\n\n- One more.\n", "under Unreleased"),
    ],
)
def test_what_is_not_ready_is_named(tree: Path, file: str, old: str, new: str, said: str) -> None:
    assert list(problems(tree)) == [], "it is ready"
    text = (tree / file).read_text(encoding="utf-8")
    assert old in text
    (tree / file).write_text(text.replace(old, new, 1), encoding="utf-8")
    found = list(problems(tree))
    assert any(said in line for line in found)
    assert any("not committed" in line for line in found)
