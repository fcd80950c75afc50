"""Ideal sonar renders: the light is the sonar, the picture is what it would hear without noise."""

from __future__ import annotations

from ..errors import FactoryError
from .base import Rendered, Renderer, RenderSettings

__all__ = ["RenderSettings", "Rendered", "Renderer", "check_renderer", "open_renderer"]


def check_renderer(settings: RenderSettings) -> None:
    """Raise FactoryError when the settings contradict each other; imports nothing heavy."""
    if settings.geometry == "points" and settings.kind != "cycles":
        raise FactoryError(
            "render.geometry=points is for render=cycles only: "
            f"set render.geometry=auto for render={settings.kind}"
        )
    if settings.bounces and settings.stride not in (1, "auto"):
        raise FactoryError(
            f"render.stride={settings.stride} is for direct sound only: "
            "set render.stride=1, or render.bounces=0"
        )


def open_renderer(settings: RenderSettings) -> Renderer:
    """The renderer that `settings.kind` names, ready to render frames in this process.

    Raises FactoryError as `check_renderer` does, and when the library cannot be loaded.
    """
    check_renderer(settings)
    # A worker that only adds noise must not pay for Blender or Open3D: import what is asked for.
    from .renderers import ClosedFormRenderer, CyclesRenderer

    return (CyclesRenderer if settings.kind == "cycles" else ClosedFormRenderer)(settings)
