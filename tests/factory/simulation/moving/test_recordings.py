"""Recordings as they come out: how grain keeps from frame to frame, and their bytes."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.seeds import stream
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.imaging.signal import Signal
from simnfnd.factory.simulation.noise.drift import drifting_volume
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.views import Views
from simnfnd.factory.simulation.render.view import View, view_of
from tests.constant_field import config, observed, ping_of
from tests.factory.simulation.moving.stage import plane

# Of lamprey1.avi, a DIDSON at rest: correlation of what a Gaussian of 5 pixels leaves.
LAMPREY = {1: 0.70, 10: 0.63}
GRAIN_PX = 5


class PlaneViews(Views):
    """The render of `plane` for every frame."""

    def __init__(self) -> None:
        super().__init__({})

    def view(self, ref) -> View:
        """See `Views`."""
        frame, rendered = plane(pitch_deg=16)
        # Half of it echoes, half is dark, as in lamprey1.
        rows, columns = np.indices(rendered.radiance.shape)
        patchy = np.sin(rows / 9) * np.cos(columns / 23) > 0
        radiance = np.where(patchy, rendered.radiance, rendered.radiance * np.float32(0.001))
        darkened = replace(rendered, radiance=radiance)
        return view_of(frame, darkened, compose_config(["experiment=fish"]).sonar.mount)


@pytest.fixture(scope="module")
def maker() -> PairMaker:
    # Static and clean images with their speckle show where objects are.
    words = ["experiment=fish", "acoustics.target=mean_log"]
    words += ["sonar.image.width_px=384", "sonar.image.height_px=384"]
    return PairMaker(compose_config(words), PlaneViews())


def frames_of(maker: PairMaker, numbers: list[int], scene: str = "seabed-0003"):
    from simnfnd.factory.dataset.frame_ref import FrameRef

    return [maker.pairs(FrameRef("seabed", scene, f"{n:04d}"), (0,))[0] for n in numbers]


@pytest.mark.slow
def test_static_grain_keeps_as_in_a_real_recording(maker):
    pairs = frames_of(maker, [0, 1, 10, 11])
    frames = np.stack([pair.noisy for pair in pairs]).astype(np.float32)
    grain = np.stack([frame - cv2.GaussianBlur(frame, (0, 0), GRAIN_PX) for frame in frames])
    static = pairs[0].layers["static"]
    shown = cv2.erode((static > 0).astype(np.uint8), np.ones((15, 15))) > 0
    # Where objects are, something else is correlated.
    for pair in pairs:
        shown &= pair.clean == pair.layers["static"]
    assert shown.sum() > 10_000

    def correlation(first: int, second: int) -> float:
        return float(np.corrcoef(grain[first][shown], grain[second][shown])[0, 1])

    assert np.mean([correlation(0, 1), correlation(2, 3)]) == pytest.approx(LAMPREY[1], abs=0.1)
    assert np.mean([correlation(0, 2), correlation(1, 3)]) == pytest.approx(LAMPREY[10], abs=0.1)


@pytest.mark.slow
def test_a_frame_is_the_same_whoever_makes_it_and_in_whatever_order(maker):
    forwards = frames_of(maker, [2, 5])
    another = PairMaker(maker.config, PlaneViews())
    backwards = frames_of(another, [5])[0], frames_of(another, [2], "seabed-0003")[0]
    for forward, backward in zip(forwards, backwards[::-1], strict=True):
        assert forward.noisy.tobytes() == backward.noisy.tobytes()
        assert forward.record["tracks"] == backward.record["tracks"]


@pytest.mark.slow
def test_parameters_of_the_noise_belong_to_the_recording(maker):
    pairs = [*frames_of(maker, [0, 7]), *frames_of(maker, [0], "seabed-0004")]
    drawn = [pair.record["noise.receiver.level_db"] for pair in pairs]
    assert drawn[0] == drawn[1]
    assert drawn[0] != drawn[2]


def test_drifting_haze_forgets_and_keeps_its_level():
    settings = config()
    ping_at_rest = ping_of(observed(settings, size=(240, 160)))

    def haze(time_s: float, drift_m_s: float = 0.0):
        frame = replace(ping_at_rest.surface.frame, time_s=time_s)
        ping = replace(ping_at_rest, surface=replace(ping_at_rest.surface, frame=frame))
        silent = Signal(np.zeros(ping.shape, np.float32), np.zeros((1, 2, *ping.shape), np.float32))
        effect = {"strength_db": -40, "correlation_s": 1.0, "drift_m_s": drift_m_s}
        return drifting_volume(silent, ping, stream(0, "haze"), **effect).field[0]

    first = haze(0.0)
    power = [float((haze(time_s) ** 2).mean()) for time_s in np.linspace(0, 3, 13)]
    assert np.std(power) / np.mean(power) < 0.05

    def likeness(field) -> float:
        return float(np.corrcoef(first.ravel(), field.ravel())[0, 1])

    assert likeness(haze(0.1)) > 0.95
    assert abs(likeness(haze(2.1))) < 0.02
    np.testing.assert_array_equal(haze(0.1), haze(0.1))
    # Ten bins away after a tenth of a second; only the amplitude falls with range.
    bin_m = ping_at_rest.bin_m
    moved = haze(0.1, drift_m_s=100 * bin_m)
    assert np.corrcoef(moved[:, 10:].ravel(), haze(0.1)[:, :-10].ravel())[0, 1] > 0.95
