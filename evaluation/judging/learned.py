"""Notes on what is judged that networks learned from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...models.pretrained.learned_files import known_as, learned_files
from .methods import Method
from .recorded import Stretch


def learned_notes(stretches: Sequence[Stretch], networks: Sequence[Method]) -> list[str]:
    """A line for each network that learned from files that it is to be judged on."""
    paths = dict.fromkeys(shot.path for stretch in stretches for shot in stretch.shots)
    notes = []
    for network in networks:
        learned = learned_files(Path(network.weights or ""))
        names = [path.name for path in paths if known_as(path, learned)]
        if names:
            more = f" and {len(names) - 1} other file(s)" if len(names) > 1 else ""
            notes.append(
                f"warning: {network.label} learned from {names[0]}{more}; figures on what weights "
                "learned from say nothing about other recordings"
            )
    return notes
