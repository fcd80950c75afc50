"""`simnfnd.Denoiser`: a live stream is the command with --causal, whatever comes in."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import simnfnd
from simnfnd import api
from simnfnd.command import main
from simnfnd.factory.common.array_types import UInt8s
from simnfnd.models.denoise import denoiser
from simnfnd.models.recordings import open_recording
from tests.models.adapt.scenes import noisy, scene
from tests.models.recordings.recording_files import pings, write_aris


def frames_of(count: int, side: int = 64) -> UInt8s:
    """(count, side, side): a static scene in noise."""
    ground = scene(0, side, side)
    stack = np.stack([noisy(ground, number) for number in range(count)])
    return np.asarray(np.rint(stack * 255), np.uint8)


def test_a_stream_has_the_bytes_of_the_command(tmp_path: Path) -> None:
    """Over several calibrations, with repeated and missing frames among them."""
    stack = frames_of(30)
    stack = np.concatenate([stack[:9], stack[8:9], stack[8:9], stack[9:14], stack[17:]])
    np.save(tmp_path / "a.npy", stack)
    words = [str(tmp_path / "a.npy"), "--out", str(tmp_path / "out"), "--causal", "--frames", "3"]
    assert main(["denoise", *words]) == 0
    with simnfnd.Denoiser(frames=3) as stream:
        denoised = [stream(frame, time_s=0.1 * number) for number, frame in enumerate(stack)]
        assert stream.counts.repeated == 2
        assert stream.counts.frames == len(stack)
    np.testing.assert_array_equal(denoised, np.load(tmp_path / "out/a.npy"))


def test_frames_of_a_recording_are_denoised_as_samples(tmp_path: Path) -> None:
    """By their beams and compass, as the command does."""
    source = write_aris(tmp_path / "a.aris", pings(10, 64, 48))
    assert main(["denoise", str(source), "--out", str(tmp_path / "out"), "--causal"]) == 0
    with open_recording(tmp_path / "out/a.aris") as recording:
        expected = [frame.samples for frame in recording]
    with simnfnd.open_recording(source) as opened, simnfnd.Denoiser() as stream:
        frames = list(opened)
        np.testing.assert_array_equal([stream(frame) for frame in frames], expected)
    with simnfnd.Denoiser() as stream:
        denoised = [stream(frame.frame) for frame in frames]
    np.testing.assert_array_equal(denoised, expected)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A network that costs nothing."""

    class Halving:
        name = "halving"
        digest = "0"

        def __init__(self, *arguments: object, **named: object) -> None: ...

        def __call__(self, grey: np.ndarray, geometry: object = None) -> np.ndarray:
            return grey / 2

    monkeypatch.setattr(denoiser, "Denoiser", Halving)
    api._denoiser.cache_clear()
    yield
    api._denoiser.cache_clear()


@pytest.mark.usefixtures("quick")
def test_frames_may_change_their_size_and_shape() -> None:
    sizes = [(40, 48), (40, 48), (32, 48), (40, 48), (40, 48, 3)]
    rng = np.random.default_rng(0)
    with simnfnd.Denoiser(geometry=None) as stream:
        for size in sizes:
            frame = rng.integers(0, 255, size, dtype=np.uint8)
            assert stream(frame).shape == size
        assert stream.counts.resized == 3


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_a_frame_keeps_its_type(dtype: type) -> None:
    full = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    frame: np.ndarray = (np.random.default_rng(0).random((40, 48)) * full).astype(dtype)
    with simnfnd.Denoiser(geometry=None, frames=1) as stream:
        assert stream(frame).dtype == dtype


@pytest.mark.usefixtures("quick")
def test_a_refused_frame_leaves_the_stream_as_it_was() -> None:
    stack = frames_of(6) / np.float32(255)
    bad = np.full((64, 64), np.nan, np.float32)
    with simnfnd.Denoiser(geometry=None) as undisturbed, simnfnd.Denoiser(geometry=None) as stream:
        for frame in stack:
            for refused in (bad, np.zeros(3, np.uint8), np.zeros((8, 8), np.int64)):
                with pytest.raises(ValueError, match=r"expected|must lie|NaN"):
                    stream(refused)
            np.testing.assert_array_equal(stream(frame), undisturbed(frame))
    with pytest.raises(ValueError, match="time_s"):
        simnfnd.Denoiser(geometry=None)(stack[0], time_s=np.nan)
    with pytest.raises(ValueError, match="closed"):
        stream(stack[0])


@pytest.mark.usefixtures("quick")
def test_memory_does_not_grow() -> None:
    """Of a stream with ever new frames, copies and sizes; see `benchmarks live` for 10,000."""
    many = 100
    rng = np.random.default_rng(0)

    def frames() -> Iterator[UInt8s]:
        for number in range(many):
            side = 24 + number % 3
            frame = rng.integers(0, 255, (side, 32), dtype=np.uint8)
            yield frame
            yield frame

    with simnfnd.Denoiser(frames=3) as stream:
        tracemalloc.start()
        sizes = []
        for frame in frames():
            stream(frame)
            sizes.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert max(sizes[-many // 2 :]) < 1.1 * max(sizes[many // 2 : many]) + 50_000


@pytest.mark.slow
def test_no_torch_is_needed(tmp_path: Path) -> None:
    script = tmp_path / "stream.py"
    script.write_text(
        "import sys\nsys.modules['torch'] = None\nimport numpy as np\n"
        "from simnfnd import Denoiser\n"
        "frame = np.random.default_rng(0).integers(0, 255, (48, 48), dtype=np.uint8)\n"
        "with Denoiser() as stream:\n    print((stream(frame) != frame).any())\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


# --- What a caller says of geometry -------------------------------------------------------------


def test_geometry_is_stated_or_refused(tmp_path: Path) -> None:
    source = write_aris(tmp_path / "a.aris", pings(1, 64, 48))
    with simnfnd.open_recording(source) as recording:
        frame = recording[0]
    samples = frame.samples
    by_frame = simnfnd.denoise(frame)
    np.testing.assert_array_equal(by_frame, simnfnd.denoise(samples, geometry=frame))
    np.testing.assert_array_equal(
        by_frame, simnfnd.denoise(samples, geometry=frame.samples_geometry)
    )
    np.testing.assert_array_equal(
        simnfnd.denoise(frame.image, geometry=frame),
        simnfnd.denoise(frame.image, geometry=frame.geometry),
    )
    geometry: Any
    for array, geometry in (
        (samples, frame.geometry),
        (frame.image, frame.samples_geometry),
        (samples[:-1], frame),
        (frame.image[::3, ::3], frame.geometry),
    ):
        with pytest.raises(ValueError, match="geometry"):
            simnfnd.denoise(array, geometry=geometry)
        with (
            pytest.raises(ValueError, match="geometry"),
            simnfnd.Denoiser(
                geometry=geometry if geometry is not frame else frame.samples_geometry
            ) as stream,
        ):
            stream(array)


def test_the_opening_of_polar_images_is_stated_or_said() -> None:
    speckle = np.random.default_rng(0).rayleigh(0.2, (40, 48)).clip(0, 1)
    image = (255 * speckle).astype(np.uint8)
    wide = simnfnd.denoise(image, geometry="polar", opening_deg=130)
    with pytest.warns(UserWarning, match="opening_deg"):
        assumed = simnfnd.denoise(image, geometry="polar")
    assert (wide != assumed).any()
    stated = simnfnd.FanGeometry.polar(np.deg2rad(130))
    np.testing.assert_array_equal(wide, simnfnd.denoise(image, geometry=stated))
    for opening_deg in (0, 361, np.nan):
        with pytest.raises(ValueError, match="opening_deg"):
            simnfnd.denoise(image, geometry="polar", opening_deg=opening_deg)
    with pytest.raises(ValueError, match="opening_deg"):
        simnfnd.denoise(image, opening_deg=30)


@pytest.mark.parametrize(
    ("name", "value"),
    [("device", "cuda"), ("device", "nonsense"), ("frames", 4), ("frames", 33), ("strength", 2)],
)
def test_parameters_are_checked_in_words_of_python(name: str, value: object) -> None:
    denoise: Any = simnfnd.denoise
    stream: Any = simnfnd.Denoiser
    for make in (lambda **given: denoise(np.zeros((8, 8)), **given), stream):
        with pytest.raises(ValueError, match=f"^{name}={value!r}"):
            make(**{name: value})
