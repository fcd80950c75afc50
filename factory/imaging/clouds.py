"""The effects of stage points, as clouds of echoes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..sonar.echoes import Echoes
from ..sonar.window import Window
from .contract import DrawnEffect


@dataclass(frozen=True, eq=False)
class EffectCloud:
    """What one effect makes: echoes of its own, or (moves) the scene's, displaced."""

    name: str
    echoes: Echoes
    moves: bool


def effect_clouds(
    effects: Iterable[DrawnEffect], scene: Echoes, movable: Echoes, window: Window
) -> tuple[EffectCloud, ...]:
    """The cloud of each effect of stage points; the others are passed over.

    scene: the resampled scene; its number of points is what densities are fractions of.
    movable: the echoes that are displaced.
    """
    return tuple(
        EffectCloud(
            effect.name, effect.apply(movable if effect.moves else scene, window), effect.moves
        )
        for effect in effects
        if effect.stage == "points"
    )


def noisy_cloud(scene: Echoes, clouds: Iterable[EffectCloud], full_scale: float) -> list[Echoes]:
    """The (displaced) scene, then the added echoes of each effect.

    full_scale: the echo level shown as grey value 1; strengths of added echoes are fractions of it.
    """
    added = []
    for cloud in clouds:
        if cloud.moves:
            scene = cloud.echoes
        else:
            added.append(cloud.echoes.louder(full_scale))
    return [scene, *added]
