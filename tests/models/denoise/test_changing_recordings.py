"""Recordings that change while they run: settings that take turns or step, channels, levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from simnfnd.factory.common.array_types import Array, Float32s
from simnfnd.factory.common.ros_types import typestore
from simnfnd.models.denoise import options
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.denoise.reports import Kinds
from simnfnd.models.denoise.temporal.grouping import Grouping
from simnfnd.models.denoise.temporal.stream import SequenceFrame
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.device_settings import (
    RecordedSettings,
    settings_in_name,
    settings_of,
)
from tests.models.denoise.test_temporal import as_it_is, noisy, scene
from tests.models.recordings.bag_files import sonar, write_bag
from tests.models.recordings.recording_files import write_aris
from tests.models.recordings.video_files import encode

SIDE = 64
COUNT = 6
WINDOW = 5
LOW = RecordedSettings(frequency_khz=750.0)
HIGH = RecordedSettings(frequency_khz=1200.0)


def static(seed: int, *, count: int = COUNT, level: float = 1.0, side: int = SIDE) -> Array:
    """(count, side, side) float32 in 0..1: one scene with noise of its own in each frame."""
    truth = scene(side, seed) * np.float32(level)
    frames = [noisy(truth / level, 100 * seed + number) * level for number in range(count)]
    stack: Array = np.stack(frames).astype(np.float32)
    return stack


def denoised(
    frames: Array,
    settings: Sequence[RecordedSettings] | None = None,
    **options: Any,
) -> tuple[Array, str]:
    """What becomes of the frames with a network that changes nothing, and the summary."""
    denoising = Denoising(as_it_is, frames=WINDOW, **options)

    def shots() -> Iterator[SequenceFrame]:
        for number, frame in enumerate(frames):
            stated = None if settings is None else settings[number]
            yield denoising.shot(number, frame, lambda _: None, number=number, settings=stated)

    results = list(denoising.sequence(shots()))
    assert [result.key for result in results] == list(range(len(frames)))
    kinds = Kinds()
    for number, result in enumerate(results):
        stated = RecordedSettings() if settings is None else settings[number]
        kinds.add(number, int(result.facts.previous), stated)
    return np.stack([result.image for result in results]), "\n".join(kinds.summary())


def in_turns(first: Array, second: Array) -> Array:
    return np.stack([first, second], axis=1).reshape(-1, *first.shape[1:])


def test_frames_of_two_settings_in_turn_equal_those_of_each_alone() -> None:
    first = static(1)
    second = first * np.float32(0.97)  # alike, but for what the recording states
    both, said = denoised(in_turns(first, second), [LOW, HIGH] * COUNT)
    np.testing.assert_array_equal(both[::2], denoised(first)[0])
    np.testing.assert_array_equal(both[1::2], denoised(second)[0])
    assert "750 kHz (6 frames, 0 to 10), 1200 kHz (6 frames, 1 to 11)" in said


def test_three_frequencies_in_rotation_and_frames_of_two_scenes_untold() -> None:
    """Each equals those of its kind alone."""
    kinds = [static(seed, count=4) for seed in (1, 2, 3)]
    rotation, _ = denoised(np.stack(kinds, axis=1).reshape(-1, SIDE, SIDE))
    for place, kind in enumerate(kinds):
        np.testing.assert_array_equal(rotation[place::3], denoised(kind)[0])


def test_frames_that_take_turns_untold_equal_those_of_each_alone() -> None:
    repeats = 2
    first = static(1)
    second = static(2, level=0.6)
    mixed = in_turns(np.repeat(first, repeats, axis=0), np.repeat(second, repeats, axis=0))
    mixed = mixed.reshape(COUNT, repeats, 2, SIDE, SIDE).swapaxes(1, 2).reshape(-1, SIDE, SIDE)
    both, said = denoised(mixed)
    both = both.reshape(COUNT, 2, repeats, SIDE, SIDE)
    for copy in range(repeats):
        np.testing.assert_array_equal(both[:, 0, copy], denoised(first)[0])
        np.testing.assert_array_equal(both[:, 1, copy], denoised(second)[0])
    assert f"like frame 0 ({COUNT * repeats} frames" in said


def test_a_title_with_noise_teaches_nothing_of_the_pings_behind_it() -> None:
    title = np.full((SIDE, SIDE), 0.1, np.float32)
    title[40:60, 10:50] = 0.6
    rng = np.random.default_rng(0)
    titles = title + rng.normal(0, 0.01, (5, SIDE, SIDE)).astype(np.float32)
    pings = static(1)
    result, said = denoised(np.concatenate([titles.clip(0, 1), pings]))
    np.testing.assert_array_equal(result[5:], denoised(pings)[0])
    assert "like frame 5" in said


def test_a_frame_of_something_else_leaves_the_others_as_they_are() -> None:
    frames = static(1)
    glitch = np.insert(frames, 5, 0.9, axis=0)
    with_glitch, _ = denoised(glitch)
    np.testing.assert_array_equal(np.delete(with_glitch, 5, axis=0), denoised(frames)[0])


def test_levels_before_and_after_a_step_stay() -> None:
    frames = static(1, count=2 * COUNT)
    frames[COUNT:] *= np.float32(0.5)
    result, said = denoised(frames)
    for before, after in zip(frames, result, strict=True):
        assert after.mean() == pytest.approx(before.mean(), rel=0.02)
    # The frames beside the step are fused with those behind it, after a gain.
    noise = np.abs(result - frames).reshape(len(frames), -1).mean(axis=1)
    usual = np.median(noise / frames.mean(axis=(1, 2)))
    assert noise[COUNT] / frames[COUNT].mean() > 0.7 * usual
    assert "kinds of frames" not in said


def test_flicker_does_not_pass_for_noise() -> None:
    steady = static(1, count=14)
    gains = np.random.default_rng(0).uniform(0.6, 1.0, 14).astype(np.float32)
    result, _ = denoised(steady * gains[:, None, None])
    truth = scene(SIDE, 1)
    errors = np.abs(result / gains[:, None, None] - truth)[:, 8:-8, 8:-8].mean()
    steady_errors = np.abs(denoised(steady)[0] - truth)[:, 8:-8, 8:-8].mean()
    recorded = np.abs(steady - truth)[:, 8:-8, 8:-8].mean()
    assert steady_errors < 0.7 * recorded
    assert errors < steady_errors + 0.2 * (recorded - steady_errors)


def test_causal_frames_come_at_once() -> None:
    denoising = Denoising(as_it_is, frames=5, causal=True)
    sequence = denoising.open_sequence(at_once=1)
    for number, frame in enumerate(in_turns(static(1), static(2, level=0.5))):
        shot = denoising.shot(number, frame, lambda _: None)
        assert [result.key for result in sequence.push(shot)] == [number]
    sequence.close()


def test_a_moving_scene_is_one_kind() -> None:
    wide = scene(SIDE + 60, 4)
    grouping = Grouping(causal=False)
    for number in range(12):
        window = wide[:SIDE, 5 * number : 5 * number + SIDE]
        grouping.add(number, noisy(window, number), RecordedSettings())
    assert [grouping.previous(number) for number in range(1, 12)] == list(range(11))


@pytest.mark.parametrize(
    ("first", "second", "is_like"),
    [
        (RecordedSettings(gain_db=20.0), RecordedSettings(gain_db=20.4), True),
        (RecordedSettings(gain_db=20.0), RecordedSettings(gain_db=23.0), False),
        (RecordedSettings(range_max_m=10.0), RecordedSettings(range_max_m=10.1), True),
        (RecordedSettings(range_max_m=10.0), RecordedSettings(range_max_m=12.0), False),
        (RecordedSettings(pulse_us=10.0), RecordedSettings(pulse_us=20.0), False),
        (RecordedSettings(head="port"), RecordedSettings(head="starboard"), False),
        (RecordedSettings(sequence="channel 1"), RecordedSettings(sequence="channel 2"), False),
        (settings_in_name("a_1200kHz_03.png"), settings_in_name("a_1.2MHz_04.png"), True),
        (settings_in_name("a_1200kHz_03.png"), settings_in_name("a_750khz_04.png"), False),
        (settings_in_name("gain 12dB 3.png"), settings_in_name("gain 24dB 4.png"), False),
    ],
)
def test_settings(first: RecordedSettings, second: RecordedSettings, is_like: bool) -> None:
    assert first.is_like(second) == second.is_like(first) == is_like
    assert bool(first.differences(second)) == (not is_like)


@pytest.mark.parametrize(
    "change", [{"offset_440": 0}, {"offset_68": 12}, {"offset_444": 40}, {"offset_452": 30}]
)
def test_headers_of_aris_that_take_turns(tmp_path: Path, change: dict[str, Any]) -> None:
    """Frequency, gain, pulse and range."""
    samples = np.zeros((8, 64, 48), np.uint8)
    files = [
        write_aris(tmp_path / "a.aris", samples).read_bytes(),
        write_aris(tmp_path / "a.aris", samples, **change).read_bytes(),
    ]
    size = 1024 + 64 * 48
    content = files[0][:1024] + b"".join(
        files[number % 2][1024 + number * size : 1024 + (number + 1) * size] for number in range(8)
    )
    (tmp_path / "a.aris").write_bytes(content)
    with open_recording(tmp_path / "a.aris") as recording:
        settings = [settings_of(frame) for frame in recording]
    assert [stated.is_like(settings[0]) for stated in settings] == [True, False] * 4


@pytest.mark.usefixtures("halving")
def test_two_heads_on_one_topic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = typestore(2)
    samples = np.rint(static(3, count=4, side=48) * 255).astype(np.uint8)
    messages = [sonar(store, number, frame) for number, frame in enumerate(samples)]
    for message in messages[1::2]:
        message.header.frame_id = "other"
    write_bag(
        tmp_path / "a.mcap", {"/a": ("marine_acoustic_msgs/msg/ProjectedSonarImage", messages)}
    )
    out = tmp_path / "out"
    assert options.main([str(tmp_path / "a.mcap"), "--out", str(out), "--frames", "3"]) == 0
    said = capsys.readouterr().out
    assert "sonar (2 frames, 0 to 2), other (2 frames, 1 to 3)" in said
    assert "--frames 1" in said


# --- depth and brightness -------------------------------------------------------------------------


@pytest.mark.parametrize("divisor", [16, 64])
def test_the_scale_of_the_echoes_does_not_matter(divisor: int) -> None:
    """Tolerance: the rounding of samples of 10 bits."""
    frames = np.rint(static(1) * 65535).astype(np.uint16)
    full, _ = denoised(frames)
    part, _ = denoised(frames // divisor)
    truth = scene(SIDE, 1)[8:-8, 8:-8]
    errors = [
        float(np.square(result[:, 8:-8, 8:-8] * scale / 65535.0 - truth).mean())
        for result, scale in ((full, 1), (part, divisor))
    ]
    assert 10 * abs(np.log10(errors[1] / errors[0])) < 0.3


def test_echoes_of_a_part_of_the_scale_as_floats() -> None:
    power = 6
    frames = static(1)
    part, _ = denoised(frames / np.float32(2**power))
    whole, _ = denoised(frames)
    error = np.abs(part * 2**power - whole).mean() / np.abs(whole - frames).mean()
    assert error < 0.1


def test_a_bright_letter_in_a_dark_recording_stays() -> None:
    frames = np.rint(static(1) * 800).astype(np.uint16)
    frames[:, 40:42, 40:42] = 65535
    result, _ = denoised(frames)
    assert (result[:, 40:42, 40:42] == 65535).all()
    plain = np.rint(static(1) * 800).astype(np.uint16)
    away = np.abs(result.astype(float) - denoised(plain)[0])[:, 60:]
    assert away.mean() < 0.1 * np.abs(plain - denoised(plain)[0].astype(float)).mean()


# --- strength -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dtype", "window"), [("uint8", 3), ("uint16", 1), ("float32", 1), ("float32", 3)]
)
def test_strength_is_the_part_of_the_change(dtype: str, window: int) -> None:
    frames = static(1, count=4)
    full = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    stored = (np.rint(frames * full) if full > 1 else frames).astype(dtype)
    changes = []
    for strength in (0, 0.25, 0.5, 0.999, 1):
        denoising = Denoising(
            lambda grey, geometry=None: grey / 2, frames=window, strength=strength
        )
        shots = (denoising.shot(n, frame, lambda _: None) for n, frame in enumerate(stored))
        result = np.stack([result.image for result in denoising.sequence(shots)])
        changes.append(float(np.abs(result.astype(float) - stored).mean()) / full)
    assert changes[0] == 0
    expected = np.array([0, 0.25, 0.5, 0.999, 1]) * changes[-1]
    np.testing.assert_allclose(changes, expected, atol=0.6 / full if full > 1 else 1e-5)


@pytest.mark.usefixtures("halving")
def write_colour_gif(path: Path, grey: Array) -> None:
    """Colours of a table of 256, in a turn of their own for each frame."""
    images = []
    for number, frame in enumerate(grey):
        image = Image.frombytes("P", frame.shape[::-1], frame.tobytes())
        image.putpalette(bytes(v for i in range(256) for v in (i, (7 * i + number) % 256, 255 - i)))
        images.append(image)
    images[0].save(path, save_all=True, append_images=images[1:])


WRITERS: dict[str, Callable[[Path, Array], object]] = {
    "a.png": lambda path, grey: cv2.imwrite(str(path), grey[0]),
    "b.png": lambda path, grey: cv2.imwrite(str(path), 257 * grey[0].astype(np.uint16)),
    "a.jpg": lambda path, grey: cv2.imwrite(str(path), grey[0]),
    "a.pgm": lambda path, grey: cv2.imwrite(str(path), grey[0]),
    "a.ppm": lambda path, grey: cv2.imwrite(str(path), np.stack([grey[0], *grey[:2]], axis=-1)),
    "a.npy": lambda path, grey: np.save(path, grey),
    "a.tif": lambda path, grey: tifffile.imwrite(path, grey / np.float32(255)),
    "a.gif": write_colour_gif,
    "a.webp": lambda path, grey: Image.fromarray(grey[0]).save(
        path, save_all=True, append_images=[Image.fromarray(grey[1])], lossless=True
    ),
    "a.avi": encode,
}


@pytest.mark.usefixtures("halving")
def test_files_of_strength_0_are_the_input(tmp_path: Path) -> None:
    grey = np.rint(static(1, count=2) * 255).astype(np.uint8)
    for name, write in WRITERS.items():
        write(tmp_path / name, grey)
    out = tmp_path / "out"
    words = ["--out", str(out), "--strength", "0", "--frames", "1", "--geometry", "none"]
    assert options.main([str(tmp_path), *words]) == 0
    for name in WRITERS:
        with open_recording(tmp_path / name) as before, open_recording(out / name) as after:
            for recorded, result in zip(before, after, strict=True):
                np.testing.assert_array_equal(recorded.samples, result.samples)


class Dimming:
    """A network that takes seven tenths of every level."""

    def __init__(self, *, knows_frames: bool) -> None:
        self.knows_frames = knows_frames

    def __call__(self, grey: Float32s, _: object = None, **__: object) -> Float32s:
        return grey * np.float32(0.3)


def dimmed(image: Array, *, knows_frames: bool) -> Array:
    """The only frame of a recording."""
    denoising = Denoising(Dimming(knows_frames=knows_frames), frames=3)
    (denoised,) = denoising.sequence([denoising.shot(0, image, lambda _: None)])
    return denoised.image


@pytest.mark.parametrize("white", [255, 1023, 4095, 65535])
def test_a_saturated_echo_keeps_its_level(white: int) -> None:
    image = saturated_square(white)
    result = dimmed(image, knows_frames=True)
    assert (result[30:50, 20:60] == white).all()
    np.testing.assert_allclose(result[52:], image[52:] * 0.3, atol=1)


def test_clipped_cells_of_points_are_noisy_too() -> None:
    """Weights for simulated points take what piles up there; those for recordings do not."""
    image = saturated_square(255)
    result = dimmed(image, knows_frames=False)
    np.testing.assert_allclose(result, image * 0.3, atol=1)


def test_darkness_is_not_saturated() -> None:
    """A few counts around black make flat squares by chance."""
    image = np.random.default_rng(0).integers(0, 2, (64, 64)).astype(np.uint8)
    image[20:40, 20:40] = 1
    result = dimmed(image, knows_frames=True)
    np.testing.assert_allclose(result, image * 0.3, atol=1)


def saturated_square(white: int) -> Array:
    levels = static(1, count=1)[0] * 0.8
    levels[30:50, 20:60] = 1
    image: Array = np.rint(levels * white).astype(np.uint8 if white == 255 else np.uint16)
    return image


# --- channels -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("halving")
@pytest.mark.parametrize("kind", ["imagej", "tifffile", "ome"])
def test_channels_of_a_stack_are_sequences_of_their_own(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    first = np.rint(static(1, count=3) * 255).astype(np.uint8)
    stack = np.stack([first, first // 2], axis=1)
    path = tmp_path / ("a.ome.tif" if kind == "ome" else "a.tif")
    if kind == "imagej":
        tifffile.imwrite(path, stack, imagej=True, metadata={"axes": "TCYX"})
    else:
        tifffile.imwrite(path, stack, ome=kind == "ome", metadata={"axes": "TCYX"})
    with open_recording(path) as recording:
        sequences = [frame.sequence for frame in recording]
    assert sequences == ["channel 1", "channel 2"] * 3
    words = ["--frames", "3" if kind == "imagej" else "1", "--geometry", "none"]
    assert options.main([str(path), "--out", str(tmp_path / "out"), *words]) == 0
    said = capsys.readouterr().out
    assert ("channel 1 (3 frames, 0 to 4), channel 2" in said) == (kind == "imagej")
    with tifffile.TiffFile(tmp_path / "out" / path.name) as result:
        assert result.series[0].shape == stack.shape
        assert result.series[0].axes == "TCYX"
