"""Finds objects in sonar images with a small network, counts what moves, and trains the network.

Boxes are float32 arrays (N, 4) of left, top, right, bottom in pixels, right and bottom exclusive.
"""

from __future__ import annotations

from pathlib import Path

from ...factory.common.errors import FactoryError

SHIPPED_NAME = "simnfnd"
"""Name of the detector that ships."""

_SHIPPED = Path(__file__).parent / "simnfnd-detector.safetensors"


def find_detector(name_or_path: str) -> Path:
    """The file of a detector: a path, or the name of the one that ships.

    Raises FactoryError when there is no such file.
    """
    path = Path(name_or_path).expanduser()
    if path.is_file():
        return path
    if name_or_path == SHIPPED_NAME and _SHIPPED.is_file():
        return _SHIPPED
    raise FactoryError(
        f"detector={name_or_path}: no such file; give one that `simnfnd evaluate transfer` wrote, "
        f"or {SHIPPED_NAME}"
    )
