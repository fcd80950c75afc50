"""Do version, changelog, citation and tree agree?  `make release` asks before it builds."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def problems(root: Path = ROOT) -> Iterator[str]:
    """One line for each thing that stands in the way of a release from `root`."""
    version = _first_match(root / "factory" / "__init__.py", r'^__version__ = "(.+)"')
    if not re.fullmatch(r"\d+\.\d+\.\d+", version or ""):
        yield f"factory/__init__.py: __version__ is {version}; expected three numbers"
    cited = _first_match(root / "CITATION.cff", r"^version: (.+)")
    if cited != version:
        yield f"CITATION.cff: version is {cited}; factory/__init__.py says {version}"
    if not _first_match(root / "CITATION.cff", r"^date-released: (\d{4}-\d\d-\d\d)$"):
        yield "CITATION.cff: no date-released; add `date-released: YYYY-MM-DD`"
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    parts = re.split(r"^## ", changelog, flags=re.MULTILINE)[1:]
    heads = [part.splitlines()[0] for part in parts]
    if not any(re.fullmatch(rf"{re.escape(version or '')}, \d{{4}}-\d\d-\d\d", h) for h in heads):
        yield f"CHANGELOG.md: no heading `## {version}, YYYY-MM-DD`"
    for part in parts:
        head, _, text = part.partition("\n")
        if head.strip() == "Unreleased" and text.strip():
            yield f"CHANGELOG.md: lines under Unreleased; move them under {version}"
    if changed := _git(root, "status", "--porcelain"):
        yield f"git: {len(changed.splitlines())} files are not committed"
    if version and _git(root, "tag", "--list", f"v{version}"):
        yield f"git: the tag v{version} exists already"


def _first_match(file: Path, pattern: str) -> str | None:
    match = re.search(pattern, file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return match.group(1) if match else None


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def main() -> int:
    """Print what stands in the way; 0 if nothing does."""
    lines = list(problems())
    for line in lines:
        print(f"error: {line}", file=sys.stderr)
    return 2 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
