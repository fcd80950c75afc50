"""Everything that decides the weights of a training, and the recordings they learn from."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ...factory.common.files import sha256_of
from ..data.pairs import Data
from ..pretrained import find_weights
from ..pretrained.learned_files import described, learned_files
from ..settings import ModelsSettings


def full_recipe(settings: ModelsSettings, data: Data) -> dict[str, Any]:
    """The settings and the facts of the data."""
    return {**recipe_of(settings), **data.facts}


def recipe_of(settings: ModelsSettings) -> dict[str, Any]:
    """The settings alone: key -> value, as JSON would give it back."""
    groups = {
        "model": settings.model,
        "loss": settings.loss,
        "data": asdict(settings.data),
        "train": asdict(settings.train),
    }
    flat = {
        f"{group}.{key}": list(value) if isinstance(value, tuple) else value
        for group, keys in groups.items()
        for key, value in keys.items()
    }
    # How many processes read, and where the images lie, decides nothing.
    for key in ("data.workers", "data.pack", "data.folder", "data.geometry"):
        flat.pop(key, None)
    # Weights count by their content.
    if settings.start is not None:
        flat["start"] = sha256_of(find_weights(settings.start))[:16]
    return {**flat, "seed": settings.seed}


def files_learned_from(settings: ModelsSettings, data: Data) -> list[dict[str, Any]]:
    """The recordings that the weights learn from, and those that they began from."""
    entries = described(data.recordings)
    if settings.start is not None:
        entries += learned_files(find_weights(settings.start))
    return [entry._asdict() for entry in dict.fromkeys(entries)]
