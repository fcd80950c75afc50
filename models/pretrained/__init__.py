"""The weights that ship: `*.safetensors` beside this file, each with a model card of its name."""

from __future__ import annotations

from pathlib import Path

from ...factory.errors import FactoryError

DEFAULT = "simnfnd"
"""Name of the weights that `simnfnd denoise` takes when none are given."""
POINTS = "simnfnd-paper"
"""Those for shards of acoustics.formation=points: trained on the paper's noise."""

REMOVAL = "simnfnd-removal"
"""Those for what lies over a picture (haze, spokes, ghosts, gains), where it is asked for."""


def shipped(folder: Path | None = None) -> dict[str, Path]:
    """Name -> file of the weights in `folder` (default: those that ship)."""
    return {path.stem: path for path in sorted((folder or _FOLDER).glob("*.safetensors"))}


def find_weights(given: str | Path | None) -> Path:
    """The weights file that is meant: a file, the name of one that ships, or None for the default.

    Raises FactoryError when there is no such file.
    """
    known = shipped()
    if given is not None and Path(given).expanduser().is_file():
        return Path(given).expanduser()
    name = DEFAULT if given is None else str(given)
    if name in known:
        return known[name]
    if given is None:
        raise FactoryError(
            "--weights: this version ships no trained weights; give the weights.safetensors that "
            "`simnfnd train dataset=DIR` wrote"
        )
    names = f"; weights that ship: {', '.join(known)}" if known else ""
    raise FactoryError(
        f"weights={given}: no such file; train one with `simnfnd train dataset=DIR`{names}"
    )


def graphs() -> tuple[Path, ...]:
    """The graphs that ship: what onnxruntime computes of the weights of such a network."""
    return tuple(sorted(_FOLDER.glob("*.onnx")))


_FOLDER = Path(__file__).parent
