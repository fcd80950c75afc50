"""Tracks: what `dataset.columns=[tracks]` says of each moving object in a frame."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Int32s, Int64s
from ...common.errors import FrameError
from ...dataset.schema import Column
from ..frames.frame import MovingPixels
from ..imaging.scatterers import camera_rays
from ..scenes.moving import TRACKS_BYTES
from ..sonar import polar
from ..sonar.fan import lay_out_nearest
from ..sonar.surface import LABELLED_BEAM_DB, LitSurface, vertical_weight
from .compose import PosedBody
from .course import velocity_m_s

_FAINTEST = 10 ** (-LABELLED_BEAM_DB / 10)
"""Two-way level of the vertical beam, on intensity, below which nothing is heard."""
TRACKS = (
    Column(
        "tracks",
        f"S{TRACKS_BYTES}",
        "",
        "JSON list of the moving objects that are there: id, class; position_m of the middle and "
        "velocity_m_s over ground (ahead, left, up) in the sonar's axes; range_m and bearing_deg "
        "(right is positive) of its echo, of its middle where none arrives; length_m along its "
        "body axis at rest, and body_bearing_deg of that axis, tail to head, in the sonar's level "
        "plane (right is positive, 0 looks away from the sonar); box (left, top, width, height) in "
        "pixels of the image, null without an echo; target_strength_db, null where the "
        "material decides; insonified, part of its outline that echoes; occluded, part that "
        "something nearer hides",
    ),
)


def tracks_row(lit: LitSurface, frequency_khz: float) -> dict[str, float | str]:
    """The value of `TRACKS` for a frame as the sonar sees it.

    Raises FrameError where more objects move than the column holds.
    """
    moving = lit.frame.moving
    if moving is None:
        return {"tracks": "[]"}
    heard = _heard(lit, moving)
    tracks = []
    for number, body in enumerate(moving.bodies):
        assert isinstance(body, PosedBody)
        own = np.flatnonzero(heard.body == number)
        alone_px = max(int(moving.alone_px[number]), 1)
        entry: dict[str, Any] = {
            "id": body.actor.number,
            "class": body.actor.class_name,
            **_motion(body, lit),
            **_echo(lit, heard, own),
            "length_m": round(body.actor.body_length_m, 4),
            "target_strength_db": _rounded(body.actor.target_strength_db(frequency_khz), 2),
            "insonified": round(min(len(own) / alone_px, 1.0), 3),
            "occluded": round(min(int(moving.hidden_px[number]) / alone_px, 1.0), 3),
        }
        if entry["box"] is None:
            entry |= _of_middle(entry["position_m"])
        tracks.append(entry)
    text = json.dumps(tracks, separators=(",", ":"), allow_nan=False)
    if len(text) > TRACKS_BYTES:
        raise FrameError(
            f"{lit.frame.ref.name}: {len(tracks)} moving objects; the column tracks holds about "
            f"{TRACKS_BYTES // 295}"
        )
    return {"tracks": text}


class _Heard(NamedTuple):
    """Pixels of moving objects that echo into the image, (K,) each.

    body: index of its object.  echoes: with strengths as the vertical beam weights them.
    bins: flat polar bin.
    """

    body: Int32s
    echoes: polar.Echoes
    bins: Int32s


def _heard(lit: LitSurface, moving: MovingPixels) -> _Heard:
    """The echoes of moving objects that the sonar hears: within its beam, window and sector."""
    frame = lit.frame
    sonar = lit.sonar
    rays = camera_rays(frame)
    row, column = np.divmod(moving.pixel, rays.depth_m.shape[1])
    z = rays.depth_m.reshape(-1)[moving.pixel].astype(np.float64)
    camera_m = np.stack([rays.across[column] * z, rays.down[row] * z, z], axis=-1)
    sonar_m = sonar.mount.in_sonar_axes(camera_m)
    strength = lit.rendered.radiance.reshape(-1)[moving.pixel].astype(np.float64)
    echoes = polar.from_xyz(sonar_m, strength)
    pattern = (np.abs(echoes.elevation_rad) <= np.deg2rad(sonar.vfov_deg) / 2).astype(np.float64)
    if lit.conical:
        pattern = vertical_weight(echoes.elevation_rad, sonar).astype(np.float64)
        echoes = echoes.in_conical_beams()
    weighted = (strength * pattern).astype(np.float32)
    echoes = replace(echoes, strength=weighted)
    bins = polar.bin_index(echoes, lit.window, sonar)
    is_heard = (pattern > _FAINTEST) & (bins < sonar.range_bins * sonar.beams) & (strength > 0)
    heard = np.flatnonzero(is_heard)
    chosen = polar.Echoes(
        echoes.range_m[heard],
        echoes.azimuth_rad[heard],
        echoes.elevation_rad[heard],
        echoes.strength[heard],
    )
    return _Heard(moving.body[heard], chosen, bins[heard])


def _motion(body: PosedBody, lit: LitSurface) -> dict[str, Any]:
    mount = lit.sonar.mount
    turn = mount.rotation_sonar_from_camera()
    camera_from_world = body.camera_from_world
    world_m = body.placement.position_m
    camera_m = camera_from_world[:3, :3] @ world_m + camera_from_world[:3, 3]
    position_m = turn @ (camera_m - mount.position_camera_m())
    velocity = velocity_m_s(body.actor.course, body.time_s)
    sonar_velocity = turn @ (camera_from_world[:3, :3] @ velocity)
    axis = turn @ (camera_from_world[:3, :3] @ body.placement.world_from_own[:, 0])
    return {
        "position_m": [_rounded(value, 4) for value in position_m.tolist()],
        "velocity_m_s": [_rounded(value, 4) for value in sonar_velocity.tolist()],
        "body_bearing_deg": round(math.degrees(math.atan2(-axis[1], axis[0])), 2),
    }


def _echo(lit: LitSurface, heard: _Heard, own: Int64s) -> dict[str, Any]:
    """Range and bearing of the echo, weighted by its strength, and the box around it."""
    echoes = heard.echoes
    sonar = lit.sonar
    if not len(own):
        return {"range_m": None, "bearing_deg": None, "box": None}
    mask = np.zeros(sonar.range_bins * sonar.beams, np.bool_)
    mask[heard.bins[own]] = True
    shape = sonar.range_bins, sonar.beams
    image = lay_out_nearest(mask.reshape(shape), lit.window, sonar)
    rows, columns = np.nonzero(image)
    if not len(rows):
        return {"range_m": None, "bearing_deg": None, "box": None}
    weight = echoes.strength[own].astype(np.float64)
    weight /= weight.sum()
    range_m = float((weight * echoes.range_m[own]).sum())
    bearing_deg = math.degrees(float((weight * echoes.azimuth_rad[own]).sum()))
    left, top = int(columns.min()), int(rows.min())
    box = [left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1]
    return {"range_m": round(range_m, 4), "bearing_deg": round(bearing_deg, 3), "box": box}


def _of_middle(position_m: list[float]) -> dict[str, Any]:
    ahead, left, up = position_m
    range_m = math.sqrt(ahead**2 + left**2 + up**2)
    bearing_deg = math.degrees(math.atan2(-left, ahead))
    return {"range_m": round(range_m, 4), "bearing_deg": round(bearing_deg, 3)}


def _rounded(value: float | None, digits: int) -> float | None:
    """A rounded number; None for one that is not known."""
    if value is None or not math.isfinite(value):
        return None
    return round(value, digits)
