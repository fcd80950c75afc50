"""All that an extension is written with: effects of noise, readers of RGBD recordings, methods.

An extension is one object: an `Effect`, a `ReaderEntry` or a `Baseline`.  A package names it as an
entry point, a script registers it (docs/extending.md).
"""

from __future__ import annotations

from .evaluation.filters import Baseline, register_method
from .factory.distribution import AnyNumber, Fraction, NonNegative, Positive
from .factory.errors import FactoryError, FrameError
from .factory.frame import Frame, FrameRef, Intrinsics, checked
from .factory.imaging.effect import Effect, EffectSettings, parameter
from .factory.noise.registry import register_effect
from .factory.scenes import register_reader
from .factory.scenes.base import Discovery, OwnSceneSettings, Reader, ReaderEntry, discovery
from .factory.settings import STRICT
from .factory.sonar.polar import Echoes
from .factory.sonar.window import Window

__all__ = [
    "STRICT",
    "AnyNumber",
    "Baseline",
    "Discovery",
    "Echoes",
    "Effect",
    "EffectSettings",
    "FactoryError",
    "Fraction",
    "Frame",
    "FrameError",
    "FrameRef",
    "Intrinsics",
    "NonNegative",
    "OwnSceneSettings",
    "Positive",
    "Reader",
    "ReaderEntry",
    "Window",
    "checked",
    "discovery",
    "parameter",
    "register_effect",
    "register_method",
    "register_reader",
]
