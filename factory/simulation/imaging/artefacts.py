"""What an effect of noise shows in an image, and what a network can learn to remove.

Apart from the effects, so that a network is run without loading their settings.
"""

from __future__ import annotations

from typing import Literal

# Grain that averages out; a level added to the ground; bright beams and arcs; copies of objects at
# the wrong place; smeared ranges; wrong gains of beams and ranges.
Artefact = Literal["speckle", "haze", "spokes", "ghosts", "blur", "gains"]
ARTEFACTS: tuple[Artefact, ...] = ("speckle", "haze", "spokes", "ghosts", "blur", "gains")
