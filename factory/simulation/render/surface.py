"""A frame made ready for rendering: its surface, albedo, light in closed form, and triangle mesh.

Camera axes (OpenCV: x right, y down, z forward), metres.  Neighbouring pixels are joined where
`kernels.joints` says so; nothing is ever stretched over an edge or over unmeasured pixels.

A pixel is a small area, but a vertex is a point: at a silhouette the ray through a pixel's centre
meets the outermost vertex of a grid mesh and slips past it half of the time.  So where a triangle
of the grid is missing, its corners' surfaces are continued half way towards each other, along their
tangent planes.  Every surface pixel is then an interior point of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ...common.array_types import Array, Bools, Float32s, Float64s, Floats, Int32s, Int64s, UInt8s
from ..frames.frame import Frame, Intrinsics
from . import kernels
from .base import RenderSettings

# Traced and closed-form light differ by rounding; a ratio of anything fainter tells nothing.
_FAINTEST = 1e-12


Grid = tuple[Array, ...]


def grid_of(depth_m: Floats, camera: Intrinsics, edge_ratio: float) -> Grid:
    """(H, W) depths as `kernels` want them, a border of one unmeasured pixel all around.

    Depth, its joints, and what it is multiplied by to give x in each column and y in each row:
    P = z K^-1 (u, v, 1)^T (Yang et al. 2024, Eq. 2).  Pixel (u, v) stands for its centre, so the
    top left pixel's centre is (0, 0); lens distortion is not looked at.
    """
    height, width = depth_m.shape
    bordered = np.zeros((height + 2, width + 2), np.float32)
    bordered[1:-1, 1:-1] = depth_m
    across = (np.arange(-1, width + 1) - camera.cx) / camera.fx
    down = (np.arange(-1, height + 1) - camera.cy) / camera.fy
    return bordered, kernels.joints(bordered, edge_ratio), across, down


@dataclass(frozen=True, eq=False)
class Surface:
    """What every n-th pixel of a frame shows, in camera axes.

    points_m: (h, w, 3) float32.  normals: (h, w, 3) float32, unit, towards the camera.
    albedo: (h, w) float32 in [0, 1].  mask: (h, w) bool, pixels that are surface.
    intrinsics: of a camera with these pixels alone.
    """

    points_m: Float32s
    normals: Float32s
    albedo: Float32s
    mask: Bools
    intrinsics: Intrinsics


@dataclass(frozen=True, eq=False)
class Pixels:
    """A frame at full resolution: which pixels are surface, and how strongly each scatters.

    depth_m, albedo: (H, W) float32.  mask: (H, W) bool.  grid: see `grid_of`.
    edge_ratio: see `RenderSettings`.  stride: interval of the traced rows and columns,
        from the first on (of two).
    """

    depth_m: Float32s
    intrinsics: Intrinsics
    albedo: Float32s
    grid: Grid
    mask: Bools
    edge_ratio: float
    stride: int

    def surface(self) -> Surface:
        """Points and normals of the traced pixels; the normals are those of full resolution."""
        camera = self.intrinsics
        stride = self.stride
        mask = np.ascontiguousarray(self.mask[::stride, ::stride])
        points_m = np.empty((*mask.shape, 3), np.float32)
        normals = np.empty_like(points_m)
        kernels.orient(self.grid, stride, points_m, normals)
        numbers = camera.fx, camera.fy, camera.cx, camera.cy
        fx, fy, cx, cy = (number / stride for number in numbers)
        albedo = np.ascontiguousarray(self.albedo[::stride, ::stride])
        return Surface(points_m, normals, albedo, mask, Intrinsics(fx, fy, cx, cy))

    def radiance(self, sonar_m: Floats) -> Float32s:
        """(H, W) float32 light of a sonar at (3,) metres in camera axes, without shadows."""
        light = kernels.shade(self.grid, self.mask, self.albedo, np.asarray(sonar_m, np.float32))
        return np.asarray(light)

    def apply(
        self,
        radiance: Float32s,
        traced: Float32s,
        known: Bools,
    ) -> Float32s:
        """(H, W) float32 full-resolution light from the closed form and the traced pixels.

        radiance: (H, W) of `radiance`.  traced: (h, w), what tracing found where `known`.
        The closed form has each pixel's own detail, tracing knows what is lit: their ratio is what
        is spread over the pixels in between.
        """
        coarse = radiance[:: self.stride, :: self.stride]
        known = known & (coarse > _FAINTEST)
        ratio = np.where(known, traced / np.where(known, coarse, 1), 0).astype(np.float32)
        # Between traced pixels the steps of the same slope are larger.
        limit = np.float32(min(1.0, self.edge_ratio * self.stride))
        light = kernels.apply_traced(radiance, self.depth_m, known, ratio, self.stride, limit)
        return np.asarray(light)


def pixels_of(frame: Frame, settings: RenderSettings, stride: int = 1) -> Pixels:
    """Albedo and surface pixels of a frame of which every `stride`-th row and column is traced."""
    depth_m = np.ascontiguousarray(frame.depth_m, np.float32)
    grid = grid_of(depth_m, frame.intrinsics, settings.edge_ratio)
    shade = albedo(frame.rgb, frame.valid, settings.albedo)
    mask = np.ascontiguousarray(cut_quads(grid[1]).mask()[1:-1, 1:-1])
    return Pixels(depth_m, frame.intrinsics, shade, grid, mask, settings.edge_ratio, stride)


MEAN_ALBEDO = 0.5

# Nothing measured is perfectly black: radiance 0 is kept for the sonar's shadow.
_DARKEST_RGB = 0.01
_DARKEST_FLATTENED = 0.1

# Linear-light weights of red, green and blue in luminance (ITU-R BT.709, the primaries of sRGB).
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)

# The local mean is taken over a window of this part of the image height: wider than the texture of
# a stone, narrower than the way over which water dims and colours the image.
_WINDOW = 1 / 8


def albedo(
    rgb: UInt8s,
    valid: Bools,
    kind: Literal["rgb", "flattened", "constant"],
) -> Float32s:
    """(H, W) float32 albedo of a colour image, in (0, 1]; 0 where not `valid`.

    rgb: (H, W, 3) uint8 sRGB.  valid: (H, W) bool, pixels that have a depth.
    kind: rgb is the luminance of the image, in linear light, for it multiplies an echo's energy and
        not its grey value; flattened is that luminance over its local mean, times MEAN_ALBEDO;
        constant is MEAN_ALBEDO.
    """
    if kind == "constant":
        return np.where(valid, np.float32(MEAN_ALBEDO), np.float32(0))
    luminance = linear_luminance(rgb)
    if kind == "rgb":
        return np.where(valid, np.maximum(luminance, np.float32(_DARKEST_RGB)), np.float32(0))
    side = max(3, round(luminance.shape[0] * _WINDOW) | 1)
    weight = valid.astype(np.float32)
    # Two box filters are close to a smooth tent.
    total = luminance * weight
    share = weight
    for _ in range(2):
        total = kernels.box_mean(total, side)
        share = kernels.box_mean(share, side)
    limits = np.float32(MEAN_ALBEDO), np.float32(_DARKEST_FLATTENED)
    flat = kernels.flattened(luminance, total, share, np.ascontiguousarray(valid), *limits)
    return np.asarray(flat)


def linear_luminance(rgb: UInt8s) -> Float32s:
    """(H, W) float32 relative luminance 0..1 of an sRGB image (IEC 61966-2-1 decoding)."""
    code = np.arange(256) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )
    luminance = kernels.weighted(np.ascontiguousarray(rgb), _LUMINANCE[:, None] * linear)
    return np.asarray(luminance)


# A tangent plane seen edge-on runs away: the rim keeps this part of the edge ratio to its pixel.
_RIM_REACH = 0.25

# Shadows are cast by the mesh moved away from the camera by this part of the distance.  A shadow
# ray starts on the very surface that could block it, and rounding decides whether it does; so
# moved, the surface is behind every one of its own points, and shadows begin a pixel's width late
# (1 mm at 1 m).
SHADOW_BIAS = 1e-3


@dataclass(frozen=True, eq=False)
class Quads:
    """The quads of four neighbouring pixels, cut into two triangles each; all (H-1, W-1) bool.

    A quad with corners a b over c d is cut along c-b into a-c-b and d-b-c or, where it `falls`,
    along a-d into a-d-b and d-a-c.  upper, lower: whether the triangle on its top side (a-b) and on
    its bottom side (c-d) is surface.
    """

    falls: Bools
    upper: Bools
    lower: Bools

    def triangles(self, upper: Bools, lower: Bools) -> Int64s:
        """(N, 3) flat pixel indices of the upper and lower triangles of the chosen quads.

        Wound so that the faces look at the camera.
        """
        triangles = []
        width = self.falls.shape[1] + 1
        for chosen in (upper, lower):
            rows, columns = np.nonzero(chosen)
            a = rows * width + columns
            b = a + 1
            c = a + width
            d = a + width + 1
            falls = self.falls[rows, columns]
            if chosen is upper:
                corners = [a, np.where(falls, d, c), b]
            else:
                corners = [d, np.where(falls, a, b), c]
            triangles.append(np.stack(corners, axis=-1))
        return np.concatenate(triangles)

    def mask(self) -> Bools:
        """(H, W) bool: pixels that are a corner of at least one surface triangle.

        A measured pixel that none of its neighbours supports is a flying pixel of the depth sensor,
        has no orientation, and is no surface.
        """
        rows, columns = self.falls.shape
        either = self.upper | self.lower
        mask = np.zeros((rows + 1, columns + 1), np.bool_)
        mask[:-1, :-1] |= self.upper | (either & self.falls)
        mask[:-1, 1:] |= self.upper | (either & ~self.falls)
        mask[1:, :-1] |= self.lower | (either & ~self.falls)
        mask[1:, 1:] |= self.lower | (either & self.falls)
        return mask


def cut_quads(joints: UInt8s) -> Quads:
    """Cut every quad of the (H, W) `joints` along the diagonal that keeps more of its surface.

    A triangle is surface when all its three sides are joined, so a quad with three pixels on a
    surface still gives the triangle between them.
    """
    across, down = (joints & bit != 0 for bit in (kernels.RIGHT, kernels.DOWN))
    falling, rising = (joints[:-1, :-1] & bit != 0 for bit in (kernels.FALLING, kernels.RISING))
    top = across[:-1, :-1]
    bottom = across[1:, :-1]
    left = down[:-1, :-1]
    right = down[:-1, 1:]
    acb = top & left & rising
    dbc = bottom & right & rising
    adb = top & right & falling
    dac = bottom & left & falling
    falls = (adb & dac & ~(acb & dbc)) | ((adb | dac) & ~(acb | dbc))
    return Quads(falls, np.where(falls, adb, acb), np.where(falls, dac, dbc))


class SurfaceMesh(NamedTuple):
    """A triangle mesh in camera axes.

    vertices_m: (N, 3) float32; the first ones are the surface pixels in image order.
    triangles: (M, 3) int32, faces towards the camera; the grid's first, then the rim's.
    pixel: (N,) int64, flat index of the pixel whose surface a vertex belongs to.
    """

    vertices_m: Float32s
    triangles: Int32s
    pixel: Int64s


def surface_mesh(pixels: Pixels, surface: Surface) -> SurfaceMesh:
    """Mesh of a frame of which every pixel is traced: the pixel grid and the rim around it.

    Frames without surface give empty arrays.
    """
    # One pixel of nothing all around gives the image border its rim too.
    joints = pixels.grid[1]
    width = pixels.mask.shape[1]
    quads = cut_quads(joints)
    mask = quads.mask()
    pixel = np.flatnonzero(pixels.mask)
    vertex_of = np.zeros(mask.size, np.int32)
    vertex_of[mask.ravel()] = np.arange(len(pixel), dtype=np.int32)
    grid = vertex_of[quads.triangles(quads.upper, quads.lower)]

    owner, partner = _rim(joints, quads, mask)
    is_half = owner != partner
    rim = vertex_of[owner]
    rim[is_half] = len(pixel) + np.arange(is_half.sum(), dtype=np.int32)
    ends = np.stack([np.divmod(end[is_half], mask.shape[1]) for end in (owner, partner)])
    owner = (ends[0, 0] - 1) * width + ends[0, 1] - 1
    half_m = _on_tangent_planes(surface, owner, ends.sum(axis=0) / 2 - 1, pixels.edge_ratio)
    return SurfaceMesh(
        np.concatenate([surface.points_m.reshape(-1, 3)[pixel], half_m]),
        np.concatenate([grid, rim]),
        np.concatenate([pixel, owner]),
    )


def _rim(joints: UInt8s, quads: Quads, mask: Bools) -> tuple[Int64s, Int64s]:
    """Rim triangles of a padded image, each corner a pixel or half way from it to another one.

    Returns owner and other (R, 3), flat indices: equal where the corner is the pixel itself.
    """
    near_surface = mask[:-1, :-1] | mask[:-1, 1:] | mask[1:, :-1] | mask[1:, 1:]
    missing = quads.triangles(near_surface & ~quads.upper, near_surface & ~quads.lower)
    measured = mask.ravel()
    bits = joints.ravel()
    width = mask.shape[1]
    x, y, z = np.concatenate([np.roll(missing, -turn, axis=1) for turn in range(3)]).T

    def meets(p: Int64s, q: Int64s) -> Bools:
        first = np.minimum(p, q)
        apart = np.abs(p - q)
        rising = apart == width - 1  # noted at the pixel on the left of the upper one
        bit = np.select(
            [apart == 1, apart == width, rising], [kernels.RIGHT, kernels.DOWN, kernels.RISING],
            kernels.FALLING,
        )  # fmt: skip
        return np.asarray(measured[p] & measured[q] & (bits[first - rising] & bit != 0))

    xy = meets(x, y)
    yz = meets(y, z)
    zx = meets(z, x)
    alone = measured[x] & ~xy & ~zx
    # An edge of the grid that ends the surface: the rim takes the same edge, vertex for vertex,
    # and nothing overlaps, so that no ray finds a crack and no shadow ray hits a double.
    pieces = [
        (alone, (x, x), (x, y), (x, z)),
        (xy & ~yz, (x, x), (y, y), (y, z)),
        (xy & ~yz & ~zx, (x, x), (y, z), (x, z)),
        (xy & yz & ~zx, (x, x), (y, y), (x, z)),
    ]
    chosen = [np.stack([np.stack(e, -1)[keep] for e in corners], -2) for keep, *corners in pieces]
    owner, partner = np.moveaxis(np.concatenate(chosen), -1, 0)
    return owner, partner


def _on_tangent_planes(
    surface: Surface, owner: Int64s, places: Float64s, edge_ratio: float
) -> Float32s:
    """(N, 3) float32 points at (2, N) rows and columns, on the tangent planes of `owner` (N,)."""
    point_m = surface.points_m.reshape(-1, 3)[owner].astype(np.float64)
    normal = surface.normals.reshape(-1, 3)[owner]
    camera = surface.intrinsics
    ray = np.ones((len(owner), 3))
    ray[:, 0] = (places[1] - camera.cx) / camera.fx
    ray[:, 1] = (places[0] - camera.cy) / camera.fy
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = (normal * point_m).sum(axis=-1) / (normal * ray).sum(axis=-1)
    reach_m = point_m[:, 2] * edge_ratio * _RIM_REACH
    depth_m = np.where(depth_m > 0, depth_m, np.inf)
    depth_m = np.clip(depth_m, point_m[:, 2] - reach_m, point_m[:, 2] + reach_m)
    return np.asarray(ray * depth_m[:, None], np.float32)
