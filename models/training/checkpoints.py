"""Checkpoints: all that a stopped training needs to go on with the same bytes."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from ...factory.common.errors import FactoryError
from ...factory.common.files import write_atomically
from .. import WEIGHTS_NAME

CHECKPOINT_NAME = "checkpoint.ckpt"
_FORMAT = "simnfnd-checkpoint/5"


def write_checkpoint(out: Path, recipe: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Keep the state of a training in its folder.  Raises FactoryError where that is full."""
    content = io.BytesIO()
    torch.save({**state, "recipe": dict(recipe), "format": _FORMAT}, content)
    write_atomically(out / CHECKPOINT_NAME, content.getvalue(), key="out")


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The state, recipe and rows of a checkpoint.  Raises FactoryError when it is damaged."""
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        if content["format"] != _FORMAT:
            raise ValueError(content["format"])
        return content
    except Exception as error:
        # torch reports a damaged file with a dozen exception types.
        raise FactoryError(
            f"{path}: damaged, or of another version; delete it or train with resume=false"
        ) from error


def checkpoint_to_continue(
    out: Path, recipe: Mapping[str, Any], resume: bool
) -> dict[str, Any] | None:
    """The checkpoint in the folder of a training, or None to start.

    resume: false deletes it.  Raises FactoryError rather than mix trainings.
    """
    path = out / CHECKPOINT_NAME
    if not resume:
        path.unlink(missing_ok=True)
        return None
    if not path.exists():
        if (out / WEIGHTS_NAME).exists():
            raise FactoryError(
                f"out={out}: holds weights but no checkpoint to continue from; choose another "
                "name=, or replace them with resume=false"
            )
        return None
    checkpoint = read_checkpoint(path)
    stored = checkpoint["recipe"]
    odd = [key for key in {**stored, **recipe} if stored.get(key) != recipe.get(key)]
    if odd:
        changes = ", ".join(f"{key} {stored.get(key)} -> {recipe.get(key)}" for key in odd)
        raise FactoryError(
            f"out={out}: holds a training with other settings ({changes}); choose another name=, "
            "or replace it with resume=false"
        )
    return checkpoint
