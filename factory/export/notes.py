"""README.md of an export: where it comes from and how it is read."""

from __future__ import annotations

from pathlib import Path

from ..dataset.read.source import Source, dataset_settings


def write_notes(source: Source, folder: Path, reading: str) -> None:
    """Write README.md; `reading` says in Markdown what the files are."""
    settings = dataset_settings(source.directory)
    name, licence = str(settings.get("name") or "dataset"), settings.get("licence") or "not stated"
    counts = "".join(f"- {split}: {count} samples\n" for split, count in source.splits.items())
    rows, columns = source.shape
    text = (
        "Pairs of simulated forward-looking-sonar images, exported from a SimNFND dataset (config "
        f"hash `{source.config_hash}`). {rows} x {columns} pixels, {source.dtype}, "
        f"{source.layout} layout.\n\n{counts}"
    )
    terms = f"{licence}. The terms of the source images hold for what is derived from them."
    write_text(folder, name, text, reading, terms)


def write_text(folder: Path, name: str, about: str, reading: str, terms: str) -> None:
    """Write README.md of these parts."""
    text = (
        f"# {name}\n\n{about.rstrip()}\n\n"
        f"## What the files are\n\n{reading}\n"
        f"## Licence\n\n{terms}\n"
    )
    (folder / "README.md").write_text(text, encoding="utf-8")
