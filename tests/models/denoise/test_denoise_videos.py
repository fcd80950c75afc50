"""Videos, and images whose colours stand for levels of echo, in `simnfnd denoise`."""

from __future__ import annotations

import resource
import signal
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array, Floats
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.denoise.video_writer import CONTAINERS, TimedImage, target_of, write_video
from simnfnd.models.denoise.writers import write_frames
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.videos import VideoFile, VideoProperties, widened
from tests.models.adapt.scenes import noisy, scene
from tests.models.denoise.untrained import main, results_in, through_network
from tests.models.recordings.video_files import decoded, encode
from tests.small_dataset import fan_images

TENTH = Fraction(1, 10)


def fans(count: int) -> Array:
    """(count, 48, 48) uint8: one scene that moves."""
    noisy, _, _ = fan_images(48, np.random.default_rng(1))
    grey = (noisy * 255).astype(np.uint8)
    return np.stack([np.roll(grey, shift, axis=1) for shift in range(count)])


@pytest.mark.parametrize(
    ("name", "codec", "stored"),
    [
        ("dive.avi", "mjpeg", "yuvj420p"),
        ("dive.mp4", "libx264", "yuv420p"),
        ("dive.m4v", "mpeg4", "yuv420p"),
        ("dive.mov", "png", "gray"),
        ("dive.mkv", "ffv1", "gray"),
        ("dive.webm", "libvpx", "yuv420p"),
    ],
)
def test_a_video_keeps_its_container_and_its_times(
    weights: Path, tmp_path: Path, name: str, codec: str, stored: str
) -> None:
    path = encode(tmp_path / name, fans(3), codec=codec, stored=stored, rate=12)
    with VideoFile(path) as recording:
        originals = [frame.samples for frame in recording]
    out = tmp_path / "out"
    words = [str(path), "--out", str(out), "--weights", str(weights), "--compare"]
    assert main([*words, "--geometry", "none"]) == 0
    with VideoFile(out / name) as recording:
        assert recording.rate_hz == pytest.approx(12, rel=1e-3)
        results = [frame.samples for frame in recording]
    assert len(results) == len(originals) == 3
    for original, result in zip(originals, results, strict=True):
        assert result.shape == original.shape
        assert np.abs(result - through_network(weights, original / 255.0) * 255).max() <= 0.51
    assert (out / "compare" / f"{name}.png").is_file()
    assert results_in(out) == ["compare", name]


@pytest.mark.parametrize("suffix", CONTAINERS)
@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("is_grey", [True, False])
def test_frames_survive_in_every_container(
    tmp_path: Path, suffix: str, bits: int, is_grey: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    shape = (4, 31, 47) if is_grey else (4, 31, 47, 3)
    values = np.random.default_rng(3).integers(0, 1 << bits, shape)
    images = values.astype(np.uint8) if bits == 8 else widened(values.astype(np.uint16), bits)
    unit = Fraction(1, 10) if suffix == ".avi" else Fraction(1, 1000)
    video = VideoProperties(bits, is_grey, unit, Fraction(10))
    path, note = target_of(tmp_path / f"a{suffix}", video)
    assert (note == "") == (path.suffix == suffix), "what a container cannot hold is said"
    times_s = [0.0, 0.1, 0.5, 0.6]
    written = map(TimedImage, images, times_s)
    write_video(path, path.suffix, written, video)
    with VideoFile(path) as recording:
        frames = list(recording)
        assert not recording.warning
    assert [frame.time_s for frame in frames] == pytest.approx(times_s)
    # Deep colours take the way from the file's bits to 16 by FFmpeg, which rounds otherwise.
    most = 0 if is_grey or bits == 8 else 1
    for frame, image in zip(frames, images, strict=True):
        assert np.abs(frame.samples.astype(int) - image).max() <= most
    assert not capfd.readouterr().err, "what FFmpeg says of codecs is of no use to anybody"


@pytest.mark.parametrize(
    ("name", "stored", "bits"),
    [
        ("a.avi", "gray16le", 16),
        ("a.mkv", "gray10le", 10),
        ("a.mkv", "gray12le", 12),
        ("a.mkv", "yuv420p10le", 10),
    ],
)
@pytest.mark.usefixtures("halving")
def test_deep_greys_keep_their_bits(
    tmp_path: Path, name: str, stored: str, bits: int, capsys: pytest.CaptureFixture[str]
) -> None:
    levels = np.linspace(0, (1 << bits) - 2, 48 * 48).astype(np.uint16) // 2 * 2
    values = np.stack([levels.reshape(48, 48)] * 2)
    grey16 = widened(values, bits)
    path = encode(tmp_path / name, grey16, pixels="gray16le", stored=stored)
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    with VideoFile(path) as before, VideoFile(tmp_path / "out" / name) as after:
        assert before[0].samples.dtype == after[0].samples.dtype == np.uint16
        assert before.properties.bits == after.properties.bits == bits
        distinct = len(np.unique(before[0].samples))
        wanted = before[1].samples / 2
        actual = after[1].samples
    assert distinct > 256
    assert len(np.unique(actual)) > 256
    assert np.abs(actual - wanted).max() <= 65535 / ((1 << bits) - 1)
    assert "skipped" not in capsys.readouterr().err


@pytest.mark.usefixtures("halving")
def test_frames_keep_times_of_a_variable_rate(tmp_path: Path) -> None:
    """More frames than the mean rate and the duration say, and fewer."""
    for name, times_ms in (
        ("faster.mkv", [0, 250, 500, 520, 540, 560, 580]),
        ("slower.mp4", [0, 20, 40, 60, 310, 560, 810]),
    ):
        path = encode(
            tmp_path / name, fans(7), codec="libx264", stored="yuv420p", rate=4, times_ms=times_ms
        )
        assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
        with open_recording(path) as recording:
            assert len(recording) == 7
            times_s = [frame.time_s for frame in recording]
            assert recording[5].time_s == times_s[5]
            np.testing.assert_array_equal(recording[5].samples, list(recording)[5].samples)
        assert times_s == pytest.approx([time_ms / 1000 for time_ms in times_ms], abs=1e-3)
        with open_recording(tmp_path / "out" / name) as denoised:
            assert [frame.time_s for frame in denoised] == pytest.approx(times_s, abs=1e-3)


@pytest.mark.parametrize("turned_deg", [0, 90, 180, 270])
@pytest.mark.usefixtures("halving")
def test_a_turned_video_is_upright_when_it_is_denoised(tmp_path: Path, turned_deg: int) -> None:
    upright = np.zeros((48, 32), np.uint8)
    # Left and above, and nowhere saturated.
    upright[4:20, 3:12] = np.linspace(50, 100, 16 * 9).astype(np.uint8).reshape(16, 9) * 2
    stored = np.rot90(upright, -turned_deg // 90)
    path = encode(tmp_path / "a.mov", [stored] * 2, codec="png", turned_deg=turned_deg)
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[1].samples, upright)
    with open_recording(tmp_path / "out" / "a.mov") as denoised:
        np.testing.assert_array_equal(denoised[1].samples, upright // 2)
    ((_, pixels), _) = decoded(tmp_path / "out" / "a.mov")
    assert pixels.shape == upright.shape, "turned once, by its pixels"


@pytest.mark.usefixtures("halving")
def test_what_webm_cannot_hold_becomes_matroska_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = encode(
        tmp_path / "a.mkv", fans(2).astype(np.uint16) << 4, pixels="gray12le", stored="gray12le"
    )
    path = path.rename(tmp_path / "a.webm")
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    assert results_in(tmp_path / "out") == ["a.webm.mkv"]
    assert "written as a.webm.mkv" in capsys.readouterr().err


def test_a_full_disk_leaves_no_half_video(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (20, 256, 256), dtype=np.uint8)
    path = encode(tmp_path / "a.mkv", noise)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, limits[1]))
    try:
        with VideoFile(path) as source, pytest.raises(FactoryError, match=r"a\.mkv"):
            write_frames(tmp_path / "out" / "a.mkv", map(TimedImage, noise), source)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert not list((tmp_path / "out").iterdir())


def levels_of(number: int) -> Array:
    return np.asarray(np.rint(np.clip(noisy(scene(0), number), 0, 1) * 255), np.uint8)


def jet(levels: Floats | Array) -> Array:
    rounded = np.rint(levels).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(rounded, cv2.COLORMAP_JET), np.uint8)


def away(frame: Array, reference: Array) -> float:
    return float(np.abs(frame.astype(int) - reference).mean())


@pytest.mark.usefixtures("halving")
def test_an_image_is_painted_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    levels = levels_of(0)
    (tmp_path / "in").mkdir()
    for suffix in ("png", "tif", "bmp"):
        assert cv2.imwrite(str(tmp_path / "in" / f"a.{suffix}"), jet(levels))
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--weights", "x", "--compare"]
    assert main(words) == 0
    for suffix in ("png", "tif", "bmp"):
        result = cv2.imread(str(tmp_path / "out" / f"a.{suffix}"), cv2.IMREAD_UNCHANGED)
        assert away(result, jet(levels / 2)) < 2
    assert "colour maps: jet in 3" in capsys.readouterr().out


@pytest.mark.usefixtures("halving")
def test_a_video_is_painted_again(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    code = cv2.VideoWriter.fourcc(*"FFV1")
    frames = [levels_of(number)[:60, :62] for number in range(3)]
    writer = cv2.VideoWriter(str(path), code, 5.0, frames[0].shape[::-1])
    for frame in frames:
        writer.write(jet(frame))
    writer.release()
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    with open_recording(tmp_path / "out" / "a.avi") as denoised:
        for before, after in zip(frames, denoised, strict=True):
            assert away(after.samples, jet(before / 2)) < 8, "a codec of video mixes colours"


def test_a_video_whose_frames_change_size_is_named(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    av: Any = import_module("av")
    (tmp_path / "in").mkdir()
    with av.open(str(tmp_path / "in" / "harbour.mkv"), "w") as output:
        stream = output.add_stream("mjpeg", rate=10)
        stream.height, stream.width, stream.pix_fmt = 48, 48, "yuvj420p"
        for number, frame in enumerate(fans(4)):
            image = frame if number < 2 else np.kron(frame, np.ones((2, 2), np.uint8))
            packet = av.Packet(cv2.imencode(".jpg", image)[1].tobytes())
            packet.stream, packet.pts, packet.dts, packet.time_base = stream, number, number, TENTH
            packet.is_keyframe = True
            output.mux(packet)
    encode(tmp_path / "in" / "river.mkv", fans(2))
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--weights", str(weights)]
    assert main([*words, "--geometry", "none"]) == 1
    said = capsys.readouterr().err
    assert "harbour.mkv: frame 2 has 96 x 96 pixels, the first 48 x 48" in said
    assert results_in(tmp_path / "out") == ["river.mkv"]
