"""The noise of frames of one scene, on noise that is known; and the ARIS profile on real frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from simnfnd.evaluation.metrics.frames import (
    FrameNoise,
    frame_noise,
    grain_correlation,
    half_width,
    ks_distance,
)
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.pairs import make_pair, observe
from simnfnd.factory.scenes.seabed.movement import moved, movements
from simnfnd.models.recordings import open_recording
from tests.frames import ground_and_post, plain_render

ROOT = Path(__file__).parents[3]
ARIS = ROOT.parent / "shared/data/aris-sdk/sample.aris"
# Camera axes (x right, y down, z forward) of one that looks along the world's x.
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def test_known_noise_is_found() -> None:
    rng = np.random.default_rng(0)
    scene = np.linspace(60, 180, 400)[:, None] + np.zeros((1, 48))
    noise = rng.gamma(4, 1, (6, 400, 48))
    found = frame_noise(scene + 5 * (noise - 4))
    assert found.std == pytest.approx(10, rel=0.02)
    assert found.constancy < 0.04
    assert found.skewness == pytest.approx(1, abs=0.1)
    assert found.kurtosis == pytest.approx(1.5, abs=0.3)
    assert found.range_half_width == pytest.approx(0.5, abs=0.02)
    assert abs(found.static_share) < 0.02


def test_grain_is_as_wide_as_its_filter() -> None:
    rng = np.random.default_rng(1)
    noise = ndimage.uniform_filter1d(rng.normal(size=(6, 400, 48)), 4, axis=1)
    found = frame_noise(128 + 40 * noise)
    assert found.range_half_width == pytest.approx(2, abs=0.1)  # a triangle of base 4
    assert found.beam_half_width == pytest.approx(0.5, abs=0.02)
    assert grain_correlation(noise[[0, 0, 0]], 1) == pytest.approx(1)


def test_half_width_between_lags() -> None:
    assert half_width(np.array([1, 0.75, 0.25])) == pytest.approx(1.5)
    assert half_width(np.array([1, 0.9, 0.8])) == 2


def test_ks_of_bytes() -> None:
    low, high = np.zeros((4, 4), np.uint8), np.full((4, 4), 9, np.uint8)
    assert ks_distance(low, low) == 0
    assert ks_distance(low, high) == 1


def simulated() -> np.ndarray:
    """Frames of `experiment=aris_raw` over a level bottom, the sonar moving as in examples."""
    config = compose_config(["experiment=aris_raw"])
    frames = []
    for number, by in enumerate(movements(ROOT / "examples/platform.csv")[:4]):
        pose = np.eye(4)
        pose[:3, 3], pose[:3, :3] = moved(np.zeros(3), LEVEL, by)
        frame = replace(ground_and_post(name=str(number)), world_from_camera=pose)
        rendered = plain_render(frame)
        # A dark bottom that is seen at a grazing angle: albedo times cosine.
        rendered = replace(rendered, radiance=rendered.radiance * np.float32(0.1))
        frames.append(make_pair(observe(frame, rendered, config), 0, config).noisy)
    return np.stack(frames)


@pytest.mark.skipif(not ARIS.is_file(), reason="needs ../shared/data/aris-sdk")
def test_aris_profile_is_as_the_recording() -> None:
    with open_recording(ARIS) as recording:
        real = np.stack([frame.samples for frame in recording])
    made = simulated()
    assert made.shape[1:] == real.shape[1:]
    goal, found = frame_noise(real), frame_noise(made)
    assert isinstance(found, FrameNoise)
    assert found.std == pytest.approx(goal.std, rel=0.1)
    assert found.constancy < 0.1
    assert found.range_half_width == pytest.approx(goal.range_half_width, rel=0.15)
    assert found.beam_half_width == pytest.approx(goal.beam_half_width, rel=0.15)
    assert ks_distance(real, made) < 0.05
    assert found.static_share == pytest.approx(goal.static_share, abs=0.03)
