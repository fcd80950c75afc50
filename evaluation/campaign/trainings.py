"""campaign.json: which trainings a campaign has finished, and how its reports name them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ..methods.networks import networks_at
from .plan import Folders

CAMPAIGN_NAME = "campaign.json"
SCHEMA = "simnfnd-campaign/1"


@dataclass(frozen=True)
class Training:
    """A finished training.

    row, seed: of the campaign.  folder: of its weights, relative to the campaign's.
    label: what the reports call it.
    """

    row: str
    seed: int
    folder: str
    label: str


def write_trainings(folders: Folders, trained: Sequence[tuple[str, int]]) -> None:
    """Write campaign.json.  trained: (row, seed), in the order in which the reports get them."""
    paths = [folders.model(row, seed) for row, seed in trained]
    labels = [method.label for method in networks_at([str(path) for path in paths], {})]
    trainings = [
        Training(row, seed, path.relative_to(folders.out).as_posix(), label)
        for (row, seed), path, label in zip(trained, paths, labels, strict=True)
    ]
    content = {"schema": SCHEMA, "trainings": [asdict(one) for one in trainings]}
    text = json.dumps(content, indent=1) + "\n"
    write_atomically(folders.out / CAMPAIGN_NAME, text.encode(), key="out")


def read_trainings(folder: Path) -> list[Training]:
    """The trainings of campaign.json in a folder.  FactoryError when there is none."""
    path = folder / CAMPAIGN_NAME
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError(f"schema {content['schema']!r}")
        return [Training(**one) for one in content["trainings"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FactoryError(
            f"{path}: absent or damaged; run `simnfnd campaign out={folder}`, which writes it"
        ) from error
