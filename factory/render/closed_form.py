"""Light in closed form, with true shadows from rays by Embree (through Open3D) where asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..frame import Frame
from .base import Rendered, RenderSettings, missing
from .mesh import SHADOW_BIAS, surface_mesh
from .mount import Mount
from .surface import Surface, pixels_of


class AnalyticRenderer:
    """Shades the normals of the pixel grid; no ray is traced, so nothing casts a shadow.

    Exact when the sonar is at the camera, where all that the camera sees is insonified; with any
    other mount it lights what the sonar cannot see.
    """

    def __init__(self, settings: RenderSettings) -> None:
        self._settings = settings

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame; see `simnfnd.factory.render.base.Renderer`."""
        pixels = pixels_of(frame, self._settings)
        return Rendered(pixels.radiance(mount.position_camera_m()), pixels.mask)


class EmbreeRenderer:
    """The same, and one ray from each traced surface pixel to the sonar."""

    def __init__(self, settings: RenderSettings) -> None:
        """Raises FactoryError when Open3D is not there: half a second and 100 MB to import."""
        self._settings = settings
        try:
            import open3d
        except (ImportError, OSError) as error:
            raise missing("embree", error) from error
        self._open3d: Any = open3d

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame; see `simnfnd.factory.render.base.Renderer`."""
        pixels = pixels_of(frame, self._settings, self._settings.stride_at(mount))
        sonar_m = mount.position_camera_m()
        radiance = pixels.radiance(sonar_m)
        # What the camera sees, a sonar at its place insonifies.
        if not mount.colocated and pixels.mask.any():
            surface = pixels.surface()
            shadow = self._shadow(surface, pixels.traced_edge_ratio, sonar_m)
            if pixels.stride == 1:
                radiance[shadow] = 0
            else:
                returned = np.where(shadow, 0, radiance[pixels.traced, pixels.traced])
                radiance = pixels.apply(radiance, returned, surface.mask)
        return Rendered(radiance, pixels.mask)

    def _shadow(
        self, surface: Surface, edge_ratio: float, sonar_m: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        """(h, w) bool: surface pixels that the mesh hides from the sonar."""
        mesh = surface_mesh(surface.points_m, surface.normals, surface.intrinsics, edge_ratio)
        scene = self._open3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(
            mesh.vertices_m * np.float32(1 + SHADOW_BIAS), mesh.triangles.astype(np.uint32)
        )
        points_m = surface.points_m[surface.mask]
        rays = np.concatenate([points_m, sonar_m.astype(np.float32) - points_m], axis=-1)
        hidden = scene.test_occlusions(self._open3d.core.Tensor(rays), tnear=0.0, tfar=1.0)
        shadow = np.zeros(surface.mask.shape, np.bool_)
        shadow[surface.mask] = hidden.numpy()
        return shadow
