"""README.md of an export: where it comes from and how it is read."""

from __future__ import annotations

from pathlib import Path

import yaml

from simnfnd.factory.dataset.write.folder import CONFIG_NAME
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.export.source import Source


def write_notes(source: Source, folder: Path, reading: str) -> None:
    """Write README.md; `reading` says in Markdown what the files are."""
    settings = dataset_settings(source.directory)
    name, licence = settings.get("name") or "dataset", settings.get("licence") or "not stated"
    counts = "".join(f"- {split}: {count} samples\n" for split, count in source.splits.items())
    rows, columns = source.shape
    text = (
        f"# {name}\n\n"
        "Pairs of simulated forward-looking-sonar images, exported from a SimNFND dataset (config "
        f"hash `{source.config_hash}`). {rows} x {columns} pixels, {source.dtype}, "
        f"{source.layout} layout.\n\n"
        f"{counts}\n"
        f"## What the files are\n\n{reading}\n"
        f"## Licence\n\n{licence}. The terms of the source images hold for what is derived from "
        "them.\n"
    )
    (folder / "README.md").write_text(text, encoding="utf-8")


def dataset_settings(directory: Path) -> dict[str, object]:
    """The `dataset` block of config.yaml; empty when there is none."""
    path = directory / CONFIG_NAME
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FactoryError(f"{path}: cannot be read ({reason}); restore or delete it") from error
    block = values.get("dataset") if isinstance(values, dict) else None
    return block if isinstance(block, dict) else {}
