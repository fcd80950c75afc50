"""Compiled loops of procedural scenes: random fields, z-buffer, relief and colours of a view.

Imported where it is used: see `simnfnd.factory.common.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....common.compiled import compiled
from ....common.elementary import exponential
from ...meshes.kernels import in_camera_axes

STEPS = 25  # steps per standard deviation of the noise that textures images
TEXTURE_M = 3.7  # side of the noise tile, which textures images at two scales
FINE_M = 0.7  # side of the same tile at the finer scale

_F = np.float32
_ZERO = _F(0)
_HALF = _F(0.5)
_ONE = _F(1)
_STEP = _F(1 / STEPS)
_BITS = np.int32(24)
_SHADE_M = _F(0.04)  # how far behind an object its shadow begins
# Of an index with a sign every access asks whether it is negative.
_U = np.uint64

_ROWS = "Array(float32, 2, 'C', readonly=True)"
_WHOLES = "Array(int32, 2, 'C', readonly=True)"
_OWNERS = "Array(uint16, 1, 'C', readonly=True)"
_PLANE = "float32[:, ::1]"
_VECTORS = "float32[:, :, ::1]"
_SIGHT = "Tuple((float32[::1], float32[:, ::1], float32[::1]))"
_SEEN = "Tuple((float32[:, ::1], int32[:, ::1]))"
_MESH = f"Tuple(({_ROWS}, {_ROWS}, {_ROWS}, {_WHOLES}))"


@compiled()
def _tile_at(tile: Any, u_m: Any, v_m: Any, scale: Any) -> Any:
    """Value of a periodic (S, S) tile between its pixels; `scale`: of (u, v) in periods."""
    side = tile.shape[0]
    x, y = u_m * scale, v_m * scale
    x = (x - np.floor(x)) * _F(side)
    y = (y - np.floor(y)) * _F(side)
    column, row = int(x), int(y)
    right, down = x - _F(column), y - _F(row)
    column, row = column & (side - 1), row & (side - 1)
    after = (column + 1) & (side - 1)
    below = (row + 1) & (side - 1)
    upper = tile[row, column] + right * (tile[row, after] - tile[row, column])
    lower = tile[below, column] + right * (tile[below, after] - tile[below, column])
    return upper + down * (lower - upper)


@compiled(f"{_VECTORS}({_VECTORS})")
def normals_of_grid(points: Any) -> Any:
    """(R, C, 3) unit normals of a grid of points, turned upward, by central differences."""
    normals = np.empty_like(points)
    rows, columns = points.shape[:2]
    for row in range(rows):
        above = points[max(row - 1, 0)]
        below = points[min(row + 1, rows - 1)]
        for column in range(columns):
            left = points[row, max(column - 1, 0)]
            right = points[row, min(column + 1, columns - 1)]
            dx = below[column, 0] - above[column, 0]
            rx = right[0] - left[0]
            dy = below[column, 1] - above[column, 1]
            ry = right[1] - left[1]
            dz = below[column, 2] - above[column, 2]
            rz = right[2] - left[2]
            x = ry * dz - rz * dy
            y = rz * dx - rx * dz
            z = rx * dy - ry * dx
            up = -_ONE if z < 0 else _ONE
            x = x * up
            y = y * up
            z = z * up
            length = max(np.sqrt(x * x + y * y + z * z), _F(1e-20))
            normal = normals[row, column]
            normal[0] = x / length
            normal[1] = y / length
            normal[2] = z / length
    return normals


@compiled()
def _rock_relief(rock_tile: Any, point: Any, normal: Any, offset: Any) -> Any:
    """Relief of rock at a point, in standard deviations, at two scales.

    The tile is laid on from the three axes and mixed by the fourth powers of the normal, so that
    it is not stretched on steep walls.
    """
    coarse = _ONE / _F(9.1)
    fine = _ONE / _F(2.3)
    x_share = normal[0] ** 2
    y_share = normal[1] ** 2
    z_share = normal[2] ** 2
    x_share = x_share * x_share
    y_share = y_share * y_share
    z_share = z_share * z_share
    total = max(x_share + y_share + z_share, _F(1e-12))
    x_share = x_share / total
    y_share = y_share / total
    z_share = z_share / total
    px = point[0] + offset[0]
    py = point[1] + offset[0]
    pz = point[2] + offset[1]
    qy = point[1] + offset[1]
    relief = x_share * _tile_at(rock_tile, py, pz, coarse)
    relief += y_share * _tile_at(rock_tile, px, pz, coarse)
    relief += z_share * _tile_at(rock_tile, px, qy, coarse)
    small = x_share * _tile_at(rock_tile, py, pz, fine)
    small += y_share * _tile_at(rock_tile, px, pz, fine)
    small += z_share * _tile_at(rock_tile, px, qy, fine)
    return relief + _F(0.35) * small


@compiled(
    f"void({_VECTORS}, {_VECTORS}, UniTuple({_PLANE}, 3), UniTuple({_ROWS}, 2), float32[::1], "
    f"float32[::1], {_VECTORS})"
)
def add_relief(
    points: Any, normals: Any, shares: Any, tiles: Any, offset: Any, heights: Any, attributes: Any
) -> None:
    """Move points (R, C, 3) of the ground along their normals by its fine relief.

    shares: (R, C) each, rockiness, share of gravel, ripples.  tiles: relief of rock and of sand.
    heights: (3,) metres of a standard deviation of rock and sand, and of a ripple's crest.
    Written, too: attributes (R, C, 3), see `Terrain.seen_from`.
    """
    rock, gravel, crest = shares
    rock_tile, sand_tile = tiles
    rock_m = heights[0]
    sand_m = heights[1]
    crest_m = heights[2]
    sandy = _ONE / _F(6.7)
    pebbly = _ONE / _F(1.7)
    first = offset[0]
    second = offset[1]
    for row in range(points.shape[0]):
        for column in range(points.shape[1]):
            point = points[row, column]
            normal = normals[row, column]
            x = point[0]
            y = point[1]
            bare = rock[row, column]
            pebbles = gravel[row, column]
            ripple = crest[row, column]
            stone = sand = stones = _ZERO
            if bare > 0:
                stone = _rock_relief(rock_tile, point, normal, offset)
            loose = _ONE - bare
            if loose != 0:
                sand = _tile_at(sand_tile, x + first, y + second, sandy)
            if pebbles != 0:
                stones = _tile_at(rock_tile, x + first, y + second, pebbly)
            relief = rock_m * bare * stone + sand_m * loose * sand
            relief += _F(0.011) * pebbles * stones + crest_m * ripple
            tone = _F(0.4) * sand + _F(0.8) * ripple + _HALF * pebbles * stones
            for k in range(3):
                point[k] += normal[k] * relief
            attributes[row, column, 0] = bare
            attributes[row, column, 1] = pebbles
            attributes[row, column, 2] = bare * stone + loose * tone


@compiled()
def _ramp(low: Any, high: Any, x: Any) -> Any:
    """0 below `low`, 1 above `high`, smooth between; see `terrain.smoothstep`."""
    t = min(max((x - low) / (high - low), _ZERO), _ONE)
    return t * t * (_F(3) - _F(2) * t)


@compiled()
def _noise(tile: Any, u: Any, v: Any, rate: Any, strength: Any) -> Any:
    """The four channels of a texture at (u, v) metres, `rate` periods a metre; see `tiles`."""
    side = tile.shape[0]
    x, y = u * rate, v * rate
    column = np.int32((x - np.floor(x)) * _F(side)) & (side - 1)
    row = np.int32((y - np.floor(y)) * _F(side)) & (side - 1)
    word = np.int32(tile[_U(row), _U(column)])
    broad = _F(np.int32(word << _BITS) >> _BITS)
    grain = _F(np.int32(word << 16) >> _BITS)
    cells = _F(np.int32(word << 8) >> _BITS)
    speckle = _F(word >> _BITS)
    broad = broad * _STEP
    grain = grain * _STEP
    cells = cells * _STEP
    speckle = speckle * _STEP
    return broad * strength, grain * strength, cells * strength, speckle * strength


@compiled()
def _ground(noise: Any, detail: Any, close: Any, surface: Any, turf: Any) -> Any:
    """Shades of sand, gravel and rock; shares of gravel, rock, algae and crust; roughness.

    noise, detail: what the texture says there, broad and fine.  close: 1 nearby, 0 where detail is
    finer than a pixel.  surface: rockiness, share of gravel, relief.
    """
    broad, grain, cells, speckle = noise
    bare, stones, tone = surface
    fine_broad, fine_grain, fine_cells, fine_speckle = detail
    rock = _ramp(_F(0.3), _F(0.7), bare + _F(0.22) * grain * close + _F(0.1) * cells)
    gravel = _ramp(_F(0.35), _F(0.65), stones + _F(0.18) * cells)
    fine = _F(0.06) * fine_grain + _F(0.05) * fine_speckle + _F(0.03) * speckle
    sand_shade = _ONE + _F(0.07) * (broad + tone) + close * fine
    gravel_shade = _ONE + _F(0.1) * broad + _F(0.16) * tone
    gravel_shade += close * (_F(0.22) * fine_cells + _F(0.1) * speckle)
    grown = _ramp(_F(0.9) - _F(1.6) * turf, _F(1.7) - _F(1.6) * turf, broad + _HALF * cells)
    crust = _ramp(_F(0.9), _F(1.5), fine_broad + _F(0.4) * speckle)
    crust *= (_ONE - _F(0.6) * grown) * _F(0.7)
    rock_shade = _ONE + _F(0.14) * tone + _F(0.12) * grain
    rock_shade += close * (_F(0.14) * fine_cells + _F(0.12) * fine_grain)
    # Crevices are dark, edges are worn bright.
    rock_shade *= _F(0.75) + _HALF * _ramp(_F(-2.0), _F(1.2), tone)
    rough = _F(0.1) + _F(0.35) * gravel + rock * (_HALF - _F(0.35) * gravel)
    return (sand_shade, gravel_shade, rock_shade), (gravel, rock, grown, crust), rough


@compiled()
def _thing(noise: Any, detail: Any, close: Any, up: Any, finish: Any) -> Any:
    """How an object looks: as `_ground`, with the object for rock, and sand on it for sand.

    up: of its normal.  finish: fouling, silt and bump.
    """
    broad, grain, cells, speckle = noise
    fouling = finish[0]
    silt = finish[1]
    bump = finish[2]
    fine_broad, fine_grain, fine_cells, _ = detail
    patchy = _F(0.6) * broad + _HALF * cells + _F(0.4) * fine_broad
    grown = _ramp(_ZERO, _F(0.9), patchy + _F(2.2) * fouling - _F(1.3)) * _F(0.85)
    crust = _ramp(_ONE, _F(1.5), fine_broad + _HALF * speckle) * min(fouling * _F(1.5), _F(0.8))
    dusted = _ramp(_F(0.45), _F(0.95), up + _F(0.12) * grain + _F(0.1) * broad) * silt
    shade = _ONE + _F(0.1) * grain + close * _F(0.1) * (fine_grain + fine_cells)
    rough = bump * _F(0.55) * (_ONE - _HALF * dusted)
    sand = _F(0.8) * (_ONE + _F(0.07) * fine_grain)
    return (sand, _ONE, shade), (_ZERO, dusted, grown, crust), rough


@compiled()
def _met(mesh: Any, number: Any, eye: Any, ray: Any) -> Any:
    """Where a ray meets a triangle of a mesh: its side (positive: from behind), normal, paint."""
    corners, facings, paints, triangles = mesh
    x, y, z = ray
    a = _U(triangles[number, 0])
    b = _U(triangles[number, 1])
    c = _U(triangles[number, 2])
    px = corners[a, 0] - eye[0]
    py = corners[a, 1] - eye[1]
    pz = corners[a, 2] - eye[2]
    qx = corners[b, 0] - eye[0]
    qy = corners[b, 1] - eye[1]
    qz = corners[b, 2] - eye[2]
    rx = corners[c, 0] - eye[0]
    ry = corners[c, 1] - eye[1]
    rz = corners[c, 2] - eye[2]
    weight_a = x * (qy * rz - qz * ry) + y * (qz * rx - qx * rz) + z * (qx * ry - qy * rx)
    weight_b = x * (ry * pz - rz * py) + y * (rz * px - rx * pz) + z * (rx * py - ry * px)
    weight_c = x * (py * qz - pz * qy) + y * (pz * qx - px * qz) + z * (px * qy - py * qx)
    facing = weight_a + weight_b + weight_c
    share = _ONE / facing
    u = weight_a * share
    v = weight_b * share
    w = weight_c * share
    normal = (
        u * facings[a, 0] + v * facings[b, 0] + w * facings[c, 0],
        u * facings[a, 1] + v * facings[b, 1] + w * facings[c, 1],
        u * facings[a, 2] + v * facings[b, 2] + w * facings[c, 2],
    )
    return facing, normal, (
        u * paints[a, 0] + v * paints[b, 0] + w * paints[c, 0],
        u * paints[a, 1] + v * paints[b, 1] + w * paints[c, 1],
        u * paints[a, 2] + v * paints[b, 2] + w * paints[c, 2],
    )  # fmt: skip


@compiled()
def _on_texture(point: Any, normal: Any, row: Any, column: Any, offset: Any) -> Any:
    """Where a point lies on the noise tiles, (across, along) in metres.

    The tiles are laid on along one axis, by chance in proportion to the normal's fourth power.
    The pixel's row and column decide, so that the same image comes out every time.
    """
    x_share = normal[0] * normal[0]
    y_share = normal[1] * normal[1]
    z_share = normal[2] * normal[2]
    x_share = x_share * x_share
    y_share = y_share * y_share
    z_share = z_share * z_share
    dither = np.uint32(row * 0x9E3779B1) ^ np.uint32(column * 0x85EBCA77)
    dither = np.uint32((dither ^ (dither >> np.uint32(15))) * np.uint32(0x2C1B3C6D))
    chance = _F(dither >> np.uint32(8)) * _F(2.0**-24) * (x_share + y_share + z_share)
    across = (point[1] if chance < x_share else point[0]) + offset[0]
    along = (point[2] if chance < x_share + y_share else point[1]) + offset[1]
    return across, along


@compiled()
def _is_shaded(point: Any, sun_sight: Any, sun_inverse: Any) -> Any:
    """Whether an object lies between a point and the sun.

    sun_sight, sun_inverse: a camera in the sun, and its (S, S) z-buffer of the objects.
    """
    eye, axes, lens = sun_sight
    side = sun_inverse.shape[0]
    left, down, distance_m = in_camera_axes(point, eye, axes)
    column = int(left / distance_m * lens[0] + lens[2] + _HALF)
    row = int(down / distance_m * lens[1] + lens[3] + _HALF)
    if not (0 <= column < side and 0 <= row < side):
        return False
    inverse = sun_inverse[row, column]
    return inverse > 0 and _ONE / inverse < distance_m - _SHADE_M


@compiled()
def _light(point: Any, normal: Any, slope: Any, sun: Any) -> Any:
    """Light on a surface: from the sun's direction, and from the sky above.

    The sun by the cosine of a rough surface, unless an object is in between.
    slope: of the finest relief.  sun: see `shade_pixels`.
    """
    direction, sun_sight, sun_inverse = sun
    sunlight = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    sunlight = max(sunlight + _HALF * slope, _ZERO)
    if _is_shaded(point, sun_sight, sun_inverse):
        sunlight = _ZERO
    skylight = (_F(0.55) + _F(0.45) * normal[2]) * (_ONE + _HALF * slope)
    return sunlight, skylight


@compiled()
def _albedo(palette: Any, channel: int, own: Any, on_ground: Any, shades: Any, shares: Any) -> Any:
    """Albedo of a surface in one colour channel: loose and firm parts, algae, crust.

    palette: see `terrain.Look`.  own: the object's own colour; the ground has that of rock.
    shades, shares: see `_ground`.
    """
    sand_shade, gravel_shade, firm_shade = shades
    gravel, share, grown, crust = shares
    loose = palette[0, channel] * sand_shade
    loose += gravel * (palette[1, channel] * gravel_shade - loose)
    firm = palette[2, channel] if on_ground else own
    firm += grown * (palette[3, channel] - firm)
    firm = (firm + crust * (palette[4, channel] - firm)) * firm_shade
    # `share` is that of rock among loose ground, or of sand lying on an object.
    under, over = (loose, firm) if on_ground else (firm, loose)
    return min(max(under + share * (over - under), _F(0.01)), _F(0.95))


@compiled(
    f"{_VECTORS}(Tuple(({_MESH}, {_MESH}, {_OWNERS}, {_ROWS})), Tuple(({_SIGHT}, {_SEEN})), "
    f"Tuple(({_ROWS}, float32, {_ROWS})), Tuple((float32[::1], {_WHOLES})), "
    f"Tuple((float32[::1], {_SIGHT}, {_PLANE})))"
)
def shade_pixels(solids: Any, camera: Any, look: Any, tile: Any, sun: Any) -> Any:
    """(h, w, 3) linear colour of every second pixel and row, from what a z-buffer met.

    All arrays are float32 where nothing else is said; arguments are tuples.

    solids: ground and things, a mesh each: points (V, 3), normals (V, 3), attributes (ground) or
        colours (things) (V, 3), and triangles (T, 3) int32; (T,) uint16, the object that each
        triangle of the things belongs to; (N, 3) fouling, silt and bump of each object.
    camera: its sight (eye (3,), axes (3, 3), lens (4,)) and its z-buffer, see `rasterise_mesh`.
    look: palette, turf and water, see `terrain.Look`.
    tile: (2,) metres where the texture begins, and the texture, see `terrain.tiles`.
    sun: (3,) direction to it; sight and (S, S) z-buffer of a camera in the sun that sees the
        objects alone.
    """
    ground, things, owners, finishes = solids
    (eye, axes, lens), (inverse, which) = camera
    palette, turf, water = look
    offset, texture = tile
    absorption = water[0]
    open_water = water[1]
    sun_colour = water[2]
    sky_colour = water[3]
    height, width = which.shape
    colour = np.empty(((height + 1) // 2, (width + 1) // 2, 3), np.float32)
    for i in range(colour.shape[0]):
        row = 2 * i
        y0 = (_F(row) - lens[3]) / lens[1]
        for j in range(colour.shape[1]):
            column = 2 * j
            number = which[row, column]
            if number < 0:
                for k in range(3):
                    colour[i, j, k] = open_water[k]
                continue
            depth = _ONE / inverse[row, column]
            x0 = (_F(column) - lens[2]) / lens[0]
            x = axes[0, 0] * x0 + axes[0, 1] * y0 + axes[0, 2]
            y = axes[1, 0] * x0 + axes[1, 1] * y0 + axes[1, 2]
            z = axes[2, 0] * x0 + axes[2, 1] * y0 + axes[2, 2]
            on_ground = number < len(ground[3])
            if not on_ground:
                number -= len(ground[3])
            solid = ground if on_ground else things
            facing, (nx, ny, nz), surface = _met(solid, number, eye, (x, y, z))
            # Thin sheets and inner sides are seen from behind: turn their normals to the camera.
            if not on_ground and facing > 0 and nx * x + ny * y + nz * z > 0:
                nx = -nx
                ny = -ny
                nz = -nz
            normal = (nx, ny, nz)
            point = (eye[0] + depth * x, eye[1] + depth * y, eye[2] + depth * z)

            across, along = _on_texture(point, normal, row, column, offset)
            noise = _noise(texture, across, along, _F(1 / TEXTURE_M), _ONE)
            # Finer than a pixel beyond a few metres, the detail varies less and would only
            # sparkle: it fades out with distance.
            detail = _noise(texture, across, along, _F(1 / FINE_M), _F(0.55))
            close = min(max(_F(1.25) - depth * _F(1 / 9), _ZERO), _ONE)
            if on_ground:
                shades, shares, rough = _ground(noise, detail, close, surface, turf)
            else:
                finish = finishes[owners[number]]
                shades, shares, rough = _thing(noise, detail, close, nz, finish)

            slope = detail[1] * rough * (_F(0.25) + _F(0.75) * close)
            sunlight, skylight = _light(point, normal, slope, sun)
            range_m = depth * np.sqrt(_ONE + x0 * x0 + y0 * y0)
            for k in range(3):
                albedo = _albedo(palette, k, surface[k], on_ground, shades, shares)
                lit = albedo * (sunlight * sun_colour[k] + skylight * sky_colour[k])
                clarity = exponential(-absorption[k] * range_m)
                colour[i, j, k] = open_water[k] + (lit - open_water[k]) * clarity
    return colour


@compiled(
    f"uint8[:, :, ::1]({_VECTORS}, float32[::1], float32, Array(uint8, 1, 'C', readonly=True), "
    "int64, int64)"
)
def expose(colour: Any, black: Any, gain: Any, gamma: Any, height: int, width: int) -> Any:
    """An image (H, W, 3) of linear colours of every second pixel, those between by their mean.

    black: (3,) black level.  gain: exposure.  gamma: (L,) codes of levels from 0 to 1.
    """
    image = np.empty((height, width, 3), np.uint8)
    rows, columns = colour.shape[:2]
    most = _F(len(gamma) - 1)
    for row in range(height):
        above = colour[row // 2]
        below = colour[min((row + 1) // 2, rows - 1)]
        for column in range(width):
            left = column // 2
            right = min((column + 1) // 2, columns - 1)
            for k in range(3):
                total = above[left, k] + above[right, k] + below[left, k] + below[right, k]
                value = (_F(0.25) * total - black[k]) * gain
                over = value - _F(0.75)
                value /= _ONE + (over if over > _ZERO else _ZERO)  # highlights roll off
                value = min(max(value, _ZERO), _ONE) * most
                image[row, column, k] = gamma[_U(value)]
    return image
