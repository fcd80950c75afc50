"""The image formations, by the values of `acoustics.formation`."""

from __future__ import annotations

from collections.abc import Mapping

from . import pointwise as points
from .coherent import scene as field
from .contract import Formation

FORMATIONS: Mapping[str, Formation] = {"points": points.observe, "field": field.observe}
