"""A synthetic RGBD frame whose geometry is known in closed form."""

from dataclasses import replace
from typing import Any

import numpy as np

from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.meaning import CLASSES
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics
from simnfnd.factory.simulation.render.base import Rendered

HEIGHT_M = 1.5
PITCH_RAD = np.deg2rad(20)
POST_M = 3.0


def ground_and_post(width=240, height=160, name="0001", scene="plain") -> Frame:
    """A flat seabed 1.5 m below a camera that looks 20 degrees down, and an upright post 3 m ahead.

    Rays that meet nothing within 12 m are invalid.
    """
    focal = width / 2 / np.tan(np.deg2rad(22.5))
    intrinsics = Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x = (u - intrinsics.cx) / focal
    y = (v - intrinsics.cy) / focal
    down = y * np.cos(PITCH_RAD) + np.sin(PITCH_RAD)
    with np.errstate(divide="ignore"):
        depth_m = np.where(down > 0, HEIGHT_M / down, 0)
    depth_m[depth_m > 12] = 0
    post = (np.abs(x) < 0.05) & ((depth_m == 0) | (depth_m > POST_M)) & (v > height * 0.2)
    depth_m[post] = POST_M
    rng = np.random.default_rng(0)
    rgb = rng.integers(90, 160, (height, width, 3), dtype=np.uint8)
    return Frame(FrameRef("here", scene, name), rgb, depth_m.astype(np.float32), intrinsics)


def labelled(**fields: Any) -> Frame:
    """`ground_and_post` with labels: the post is a pillar, number 7."""
    frame = ground_and_post(480, 320)
    post = frame.depth_m == np.float32(POST_M)
    return replace(
        frame,
        segmentation=np.where(post, CLASSES.index("Pillar"), 0).astype(np.uint8),
        instance=np.where(post, 7, 0).astype(np.uint16),
        **fields,
    )


def plain_render(frame: Frame) -> Rendered:
    """Every measured pixel echoes with 1 / range^2."""
    focal = frame.intrinsics.fx
    cx = frame.intrinsics.cx
    cy = frame.intrinsics.cy
    v, u = np.indices(frame.depth_m.shape)
    slant = np.sqrt(1 + ((u - cx) / focal) ** 2 + ((v - cy) / focal) ** 2)
    range_m = np.maximum(frame.depth_m * slant, 1e-6)
    radiance = np.where(frame.valid, 1 / range_m**2, 0).astype(np.float32)
    return Rendered(radiance, frame.valid)
