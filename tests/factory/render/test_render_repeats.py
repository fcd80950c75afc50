"""The same bytes whatever was rendered before; bounces and samples."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from simnfnd.factory.frame import Frame, Intrinsics
from tests.factory.render.renderers import ABOVE, HERE, KINDS, LEFT, digest, render
from tests.project_files import ROOT
from tests.render_scenes import frame_of, plane_depth, yard

# ---- repeatability ----


@pytest.mark.parametrize("kind", KINDS)
def test_same_bytes_whatever_was_rendered_before(kind: str) -> None:
    frame, other = yard(152, 242), yard(100, 130, seed=3)
    mounts = (HERE,) if kind == "analytic" else (HERE, LEFT)
    first = [digest(render(kind, frame, mount)) for mount in mounts]
    render(kind, other, HERE if kind == "analytic" else ABOVE)
    assert [digest(render(kind, frame, mount)) for mount in mounts] == first


@pytest.fixture(scope="module")
def fresh_process() -> Iterator[subprocess.Popen[str]]:
    """Another process that renders the same with Cycles, started early as Blender takes a while."""
    pytest.importorskip("bpy")
    script = (
        "from tests.factory.render.renderers import LEFT, digest, render\n"
        "from tests.render_scenes import yard\n"
        "print(digest(render('cycles', yard(152, 242), LEFT)))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    yield process
    process.kill()
    process.wait()


def test_a_fresh_process_gives_the_same_bytes_and_prints_nothing_else(
    fresh_process: subprocess.Popen[str],
) -> None:
    printed, _ = fresh_process.communicate(timeout=120)
    assert fresh_process.returncode == 0
    assert printed == digest(render("cycles", yard(152, 242), LEFT)) + "\n"


# ---- bounces and samples ----


def _groove() -> Frame:
    """Two walls that meet in an upright 90 degree groove, 3 m ahead."""
    camera = Intrinsics(90.0, 90.0, 47.5, 31.5)
    left = plane_depth(64, 96, camera, (-(0.5**0.5), 0.0, 0.5**0.5), 3 * 0.5**0.5)
    right = plane_depth(64, 96, camera, (0.5**0.5, 0.0, 0.5**0.5), 3 * 0.5**0.5)
    return frame_of(np.minimum(left, right), camera)


def test_bounces_light_up_a_groove() -> None:
    frame = _groove()
    direct = render("cycles", frame, albedo="constant").radiance
    bounced = render("cycles", frame, albedo="constant", bounces=2, samples=16).radiance
    again = render("cycles", frame, albedo="constant", bounces=2, samples=16).radiance
    np.testing.assert_array_equal(bounced, again)
    assert bounced.mean() > 1.05 * direct.mean()
    assert (bounced >= direct * 0.999).mean() > 0.999
