"""The choices of a group of the configuration, such as the devices of `sonar=DEVICE`."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from .hydra_loader import searched_folders


def choices_of(group: str) -> list[str]:
    """Their names, sorted: of the package, and of the folders of `--config-dir`."""
    folders = (Path(str(files("simnfnd.conf"))), *searched_folders())
    return sorted({path.stem for folder in folders for path in (folder / group).glob("*.yaml")})
