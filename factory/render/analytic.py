"""The rendering equation in closed form: no ray is traced, so nothing casts a shadow.

Exact when the sonar is at the camera, where all that the camera sees is insonified; with any other
mount it lights what the sonar cannot see (`casts_shadows` is False, for callers to refuse that).
"""

from __future__ import annotations

from ..frame import Frame
from .base import Rendered, RenderSettings
from .mount import Mount
from .surface import pixels_of


class AnalyticRenderer:
    """Shades the normals of the pixel grid, in compiled loops."""

    casts_shadows = False

    def __init__(self, settings: RenderSettings) -> None:
        self._settings = settings

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame; see `simnfnd.factory.render.base.Renderer`."""
        pixels = pixels_of(frame, self._settings)
        return Rendered(pixels.radiance(mount.position_camera_m()), pixels.mask)
