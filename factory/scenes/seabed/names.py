"""The names that the settings of `scenes=seabed` use; loads nothing else."""

from __future__ import annotations

from typing import Literal, get_args

from ...labels import ObjectName

KindName = ObjectName

# The order is the order in which locations 0, 1, 2, ... take them.
PlaceName = Literal[
    "debris", "canyon", "reef", "pier", "pipeline", "rubble", "quay", "sand", "garden", "wall"
]

PLACE_NAMES: tuple[PlaceName, ...] = get_args(PlaceName)
