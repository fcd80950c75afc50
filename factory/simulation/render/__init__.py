"""Renders the ideal echo: the sonar is the light, the image what it hears without noise."""

from __future__ import annotations

from .base import Rendered, Renderer, RenderSettings

__all__ = ["RenderSettings", "Rendered", "Renderer", "open_renderer"]


def open_renderer(settings: RenderSettings) -> Renderer:
    """The renderer that `settings.kind` names, ready to render frames in this process.

    Raises FactoryError when its library cannot be loaded.
    """
    # A worker that only adds noise must not pay for Blender or Open3D: import what is asked for.
    from .renderers import ClosedFormRenderer, CyclesRenderer

    return (CyclesRenderer if settings.kind == "cycles" else ClosedFormRenderer)(settings)
