"""Holds the weights that ship, each with its model card, and finds weights by name."""

from __future__ import annotations

import re
from pathlib import Path

from ...factory.common.errors import FactoryError
from ...factory.common.extras import Need, require
from .. import WEIGHTS_NAME

DEFAULT = "simnfnd"
"""Name of the weights that `simnfnd denoise` takes when none are given."""
POINTS = "simnfnd-paper"
"""Name of the weights for the paper's noise, which shards of acoustics=pointwise get."""


def shipped() -> dict[str, Path]:
    """Name -> file of the weights; beside each lies its graph (`.onnx`)."""
    return {path.stem: path for path in sorted(_FOLDER.glob("*.safetensors"))}


def find_weights(name_or_path: str | Path | None) -> Path:
    """The file of weights, given as a file, a training's folder, a name, or None: the default.

    `OWNER/NAME`, where there is no such file, is a repository of the Hugging Face Hub that holds a
    `weights.safetensors`.
    Raises FactoryError when there is no such file.
    """
    known = shipped()
    if name_or_path is not None:
        path = Path(name_or_path).expanduser()
        weights = path / WEIGHTS_NAME if path.is_dir() else path
        if weights.is_file():
            return weights
    name = DEFAULT if name_or_path is None else str(name_or_path)
    if name in known:
        return known[name]
    if re.fullmatch(r"[\w.-]+/[\w.-]+", name) and not Path(name).suffix:
        return _of_hub(name)
    raise FactoryError(
        f"weights={name_or_path}: no such file; train one with `simnfnd train dataset=DIR`; "
        f"weights that ship: {', '.join(known)}"
    )


def _of_hub(repository: str) -> Path:
    """`weights.safetensors` of a repository, fetched once; FactoryError where that fails."""
    require([Need(f"weights={repository}", "huggingface_hub")])
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(repository, WEIGHTS_NAME))
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:160]
        raise FactoryError(
            f"weights={repository}: no such file, and the Hugging Face Hub gives none: {reason}"
        ) from error


_FOLDER = Path(__file__).parent
