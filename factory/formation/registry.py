"""The image formations, by the values of `acoustics.formation`."""

from __future__ import annotations

from collections.abc import Mapping

from simnfnd.factory.formation import points
from simnfnd.factory.formation.contract import Formation
from simnfnd.factory.formation.field import scene as field

FORMATIONS: Mapping[str, Formation] = {"points": points.observe, "field": field.observe}
