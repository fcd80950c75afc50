"""`simnfnd evaluate real`: figures without truth, static scenes, recordings in time."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.judging import sequences
from simnfnd.evaluation.judging.methods import Method
from simnfnd.evaluation.judging.recorded import RecordedImage, open_input, open_real
from simnfnd.evaluation.metrics.measure import MeasuredImage
from simnfnd.evaluation.real import in_time
from simnfnd.evaluation.real.groups import Group, judged, nearest, search, sector_of
from simnfnd.factory.common.array_types import Array, Float32s, UInt8s
from simnfnd.factory.common.workers.tasks import TaskPool
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.denoise.options import FRAMES
from simnfnd.models.recordings.static import aligned, moving
from tests.evaluation.evaluation_settings import BROKEN

MDD_SHAPE = (480, 320)
MDD_GEOMETRIES = {
    "A": FanGeometry.fan(
        math.radians(29.4), apex_x_px=159.3, apex_y_px=602.5, near_px=139.5, far_px=575.5
    ),
    "B": FanGeometry.fan(
        math.radians(29.6),
        apex_x_px=159.3,
        apex_y_px=748.5,
        near_px=291.5,
        far_px=718.5,
        x_scale=0.8,
    ),
}
"""The two fans of the Marine Debris Dataset; B shows x squeezed to 0.8 of y."""
SHAPE = (120, 96)
SECTOR = np.ones(SHAPE, bool)
SECTOR[:, :8] = SECTOR[:, -8:] = False


def real(out: Path, *words: str) -> dict[str, Any]:
    """What `evaluate real` writes."""
    assert main(["evaluate", "real", *words, f"out={out}", "workers=1"]) == 0
    content: dict[str, Any] = json.loads((out / "real.json").read_text(encoding="utf-8"))
    return content


def mean(row: dict[str, Any], metric: str) -> float:
    return float(row["metrics"][metric]["mean"])


def save(path: Path, image: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8))


def fans(root: Path, count: int) -> Path:
    """Images of both fans with speckle, a shadow and a bright object each."""
    rng = np.random.default_rng(0)
    for number in range(count):
        name = "AB"[number % 2]
        sector = MDD_GEOMETRIES[name].sector_mask(*MDD_SHAPE)
        clean = np.where(sector, 0.4, 0.0)
        row = int(rng.integers(90, 220))
        column = int(rng.integers(130, 170))
        clean[row : row + 24, column : column + 24] = 0.8
        clean[row + 30 : row + 150, column - 40 : column + 64] *= 0.05
        noisy = clean * rng.gamma(6, 1 / 6, clean.shape)
        save(root / "Images" / f"{number:02d}.png", np.where(sector, np.maximum(noisy, 1 / 255), 0))
    return root


def shown(shot: RecordedImage) -> MeasuredImage:
    image, geometry = shot.read()
    return MeasuredImage(image, sector_of(image, geometry))


def test_both_fans_of_a_mixed_folder_are_found(tmp_path: Path) -> None:
    shots, _ = open_real(fans(tmp_path / "mdd", 2))
    for shot, name in zip(shots, "AB", strict=True):
        shared = shown(shot)
        expected = MDD_GEOMETRIES[name].sector_mask(*MDD_SHAPE)
        assert (shared.sector & expected).sum() > 0.95 * (shared.sector | expected).sum()
        # Dark ground lies in the shadow.
        assert shared.noisy[shared.dark].mean() < 0.3 < shared.noisy[shared.bright].mean()


def test_figures_say_what_was_done(tmp_path: Path) -> None:
    (stretch,), _ = open_input(str(fans(tmp_path / "mdd", 1)))
    shared = shown(stretch.shots[0])
    same = shared.figures(shared.noisy)
    assert same["edges_kept"] == pytest.approx(1)
    blurred = cv2.GaussianBlur(shared.noisy, (0, 0), 2)
    smooth = shared.figures(np.asarray(blurred, np.float32))
    assert smooth["enl"] > 3 * same["enl"]
    assert smooth["edges_kept"] < 0.5
    half = shared.figures(shared.noisy / 2)
    for name in ("enl", "cnr", "edges_kept"):
        assert half[name] == pytest.approx(same[name], rel=1e-4), name
    black = shared.figures(np.zeros_like(shared.noisy))
    assert math.isnan(black["edges_kept"])


def test_the_report_of_a_folder_without_static_groups(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(REGISTRY, "broken", BROKEN)
    folder = fans(tmp_path / "mdd", 2)
    out = tmp_path / "out"
    content = real(out, str(folder), "baselines=[gaussian,median,broken]", "examples=2")
    assert "| noisy |" in capsys.readouterr().out
    rows = {row["label"]: row for row in content["rows"]}
    assert list(rows) == ["noisy", "gaussian", "median", "broken"]
    assert "no such luck" in rows["broken"]["lost"]
    assert mean(rows["gaussian"], "enl") > mean(rows["noisy"], "enl")
    page = (out / "real.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2 * 3
    assert "lost:" in page
    assert "http" not in page.replace('<html lang="en">', ""), "works without a network"


# --- static scenes -------------------------------------------------------------------------------


def scene(seed: int) -> Float32s:
    """Blobs of two sizes on a grey floor in 0..1, wider than a frame."""
    rng = np.random.default_rng(seed)
    wide = rng.normal(0, 1, (SHAPE[0] + 40, SHAPE[1] + 40)).astype(np.float32)
    actual = np.asarray(sum(size * cv2.GaussianBlur(wide, (0, 0), size) for size in (2.5, 5.0)))
    return np.asarray(np.clip(0.45 + 0.2 * actual / actual.std(), 0, 1), np.float32)


def frame(
    seed: int, rng: np.random.Generator, noise: float, shift: tuple[float, float] = (0, 0)
) -> Float32s:
    """The scene lies `shift` pixels right and down of the middle."""
    matrix = np.array([[1, 0, 20 - shift[0]], [0, 1, 20 - shift[1]]], np.float64)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    observed = cv2.warpAffine(scene(seed), matrix, SHAPE[::-1], flags=flags)
    return np.asarray(np.clip(observed + rng.normal(0, noise, SHAPE), 0, 1), np.float32)


def stored(seed: int, count: int) -> list[UInt8s]:
    """The scene so many times, (H, W) uint8, each with noise of its own."""
    rng = np.random.default_rng(1000 + seed)
    return [np.rint(frame(seed, rng, 0.08) * 255).astype(np.uint8) for _ in range(count)]


def shuffled(folder: Path, counts: dict[int, int]) -> Path:
    """Images of several scenes in one folder, in no order.  counts: seed -> frames."""
    images = [image for seed, count in counts.items() for image in stored(seed, count)]
    folder.mkdir(parents=True)
    for number, place in enumerate(np.random.default_rng(0).permutation(len(images))):
        cv2.imwrite(str(folder / f"{number:03d}.png"), images[place])
    return folder


def recording(path: Path, seed: int, count: int) -> Group:
    """A video of one scene, and the group of its frames."""
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, SHAPE[::-1], True)
    for image in stored(seed, count):
        video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    video.release()
    shots = tuple(RecordedImage(path, number, f"{path.name}#{number}") for number in range(count))
    return Group(path.name, shots, np.zeros((count, 2)), None, np.ones(SHAPE, bool), 1.0)


def test_frames_that_moved_too_far_are_left_out() -> None:
    rng = np.random.default_rng(3)
    shifts = [(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (0.0, -1.0)]
    group = aligned([frame(0, rng, 0.03, shift) for shift in shifts], SECTOR)
    assert group.numbers == (0, 1, 3)
    assert np.abs(group.shifts_px - np.array([shifts[0], shifts[1], shifts[3]])).max() < 0.15


def test_moving_objects_are_found() -> None:
    rng = np.random.default_rng(6)
    frames = []
    for number in range(10):
        image = frame(0, rng, 0.05)
        image[24:37, 8 + 6 * number : 21 + 6 * number] = 1
        frames.append(image)
    actual = moving(frames, SECTOR)
    assert actual[30, 18:65].mean() > 0.9
    assert actual[70:].mean() < 0.02


def group(folder: Path, values: list[int]) -> Group:
    """A group of even images."""
    shots = []
    for number, value in enumerate(values):
        path = folder / f"{number}.png"
        cv2.imwrite(str(path), np.full(SHAPE, value, np.uint8))
        shots.append(RecordedImage(path, 0, path.name))
    still = np.zeros((len(shots), 2)), None, np.ones(SHAPE, bool), 1.0
    return Group("even", tuple(shots), *still)


def test_a_shuffled_folder_is_judged_by_its_groups(tmp_path: Path) -> None:
    folder = shuffled(tmp_path / "in", {0: 11, 1: 7, 2: 3})
    content = real(tmp_path / "out", str(folder), "baselines=[gaussian]", "examples=1")
    assert sorted(len(entry["frames"]) for entry in content["groups"]) == [7, 11]
    assert [entry["fold"] for entry in content["groups"]] == [0, 1]
    assert len(content["files"]) == 18, "the third scene has too few frames"
    rows = {row["label"]: row for row in content["rows"]}
    noisy = rows["noisy"]
    blurred = rows["gaussian tuned on others"]
    # Noise of .08, and an eleventh or seventh of it in the truth; levels take some away.
    assert 20.5 < mean(noisy, "psnr") < 23
    assert mean(blurred, "gain_db") > 5
    assert len(blurred["parameters"]) == 2
    psnr_db = blurred["metrics"]["psnr"]
    assert psnr_db["low"] <= psnr_db["mean"] <= psnr_db["high"]
    assert content["best_filter"]["psnr"] == "gaussian tuned on others"
    margin_db = noisy["against_best"]["psnr"]["mean"]
    assert margin_db == pytest.approx(-mean(blurred, "gain_db"), abs=1e-6)
    text = (tmp_path / "out" / "real.md").read_text(encoding="utf-8")
    assert "2 static groups of 18 frames" in text
    # The example shows two rows and the truth.
    page = (tmp_path / "out" / "real.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 3


def test_of_a_recording_one_half_tunes_and_the_other_is_judged(tmp_path: Path) -> None:
    path = tmp_path / "dive.avi"
    recording(path, 3, 9)
    theirs = tmp_path / "theirs" / "dive"
    theirs.mkdir(parents=True)
    for number, image in enumerate(stored(3, 9)):
        cv2.imwrite(str(theirs / f"{number:06d}.png"), cv2.GaussianBlur(image, (0, 0), 1.5))
    pictures = f"pictures=[{{name: theirs, dir: {theirs.parent}}}]"
    content = real(tmp_path / "out", str(path), "baselines=[gaussian]", "limit=8", pictures)
    (actual,) = content["groups"]
    assert actual["frames"] == [f"dive.avi#{number}" for number in range(8)]
    assert actual["judged"] == actual["frames"][4:]
    assert any("tuned on frames of its first half (4)" in note for note in content["notes"])
    rows = {row["label"]: row for row in content["rows"]}
    assert mean(rows["gaussian tuned on others"], "gain_db") > 3
    assert rows["noisy"]["metrics"]["psnr"]["low"] is None
    assert mean(rows["theirs"], "gain_db") > 3


def test_the_truth_of_a_frame_does_not_hold_it(tmp_path: Path) -> None:
    values = [10, 20, 30, 40, 50, 60, 70, 90, 100, 130]
    (judged_frame,) = judged(0, group(tmp_path, values), [1])
    assert judged_frame.reference is not None
    assert judged_frame.noisy[0, 0] * 255 == pytest.approx(20)
    assert judged_frame.reference[0, 0] * 255 == pytest.approx((sum(values) - 20) / 9, rel=1e-5)
    assert nearest(10, 5, 7) == [2, 3, 4, 5, 6, 7, 8]
    assert nearest(10, 9, 7) == [3, 4, 5, 6, 7, 8, 9]


def blurred(grey: Any, geometry: object = None, **more: object) -> Any:
    return cv2.GaussianBlur(grey, (0, 0), 1.0)


def timed(groups: list[Group], networks: list[Method], most: int = 24) -> tuple[Any, list[str]]:
    settings: Any = SimpleNamespace(in_time=most, device="cpu", image_timeout_s=60)
    with TaskPool(1) as pool:
        return in_time.judged_in_time(settings, groups, networks, pool)


def test_every_second_frame_is_input_and_the_frames_between_are_truth() -> None:
    frames = np.arange(12, dtype=np.float32)[:, None, None] / 12 * np.ones((1, 16, 16), np.float32)
    static = in_time.static_input(frames, np.ones((16, 16), bool))
    np.testing.assert_array_equal(static.frames, frames[::2])
    np.testing.assert_allclose(static.references, frames[1::2].mean() * np.ones((6, 16, 16)))
    moving, ghost = list(in_time.kinds_of(static))[1:]
    assert moving.frames.shape == (6, 9, 9)
    assert set(np.unique(moving.frames[3])) == set(np.unique(frames[6])), "whole pixels"
    assert not ghost.levels
    assert (ghost.references[2] > 0.7).any()


@pytest.mark.slow
def test_rows_of_networks_and_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequences, "network", lambda weights, device: blurred)
    method = Method("one", "", {}, weights="one")
    groups = [recording(tmp_path / f"{seed}.avi", seed, 28) for seed in (0, 1)]
    actual, notes = timed(groups, [method])
    average = f"mean of {FRAMES}"
    rows = [
        "one: one frame",
        "one: fused and denoised",
        "fused",
        average,
        f"{average} + tuned TV",
        f"registered {average} + tuned TV",
    ]
    assert list(actual["row"].unique()) == rows
    assert list(actual["kind"].unique()) == ["static", "moving", "ghost"]
    assert len(actual) == 2 * 3 * len(rows)
    psnr = actual.groupby(["kind", "row"])["psnr"].last()
    assert psnr["static", f"{average} + tuned TV"] > psnr["static", average]
    assert psnr["moving", average] < psnr["moving", "fused"]
    assert psnr["moving", f"registered {average} + tuned TV"] > psnr["moving", average] + 2
    assert notes[1].startswith(
        "1.avi: TV of means is tuned on the first half of the frames (weight"
    )
    table = in_time.wide(actual, resamples=100, seed=0)
    assert all(" .. " in cell for cell in table["static, dB / SSIM"]), "two recordings"
    single = in_time.wide(actual[actual["recording"] == "0.avi"], resamples=100, seed=0)
    assert not any(" .. " in cell for cell in single["static, dB / SSIM"])
    assert list(table) == ["row", *(f"{k}, dB / SSIM" for k in ("static", "moving", "ghost"))]
    assert list(table["row"]) == rows


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    save(tmp_path / "black" / "0.png", np.zeros((40, 40)))
    save(tmp_path / "plain" / "0.png", np.full((40, 40), 0.5))
    plain = str(tmp_path / "plain")
    for words, message in (
        ((str(tmp_path / "none"),), "no such folder or recording"),
        ((str(tmp_path / "empty"),), "holds no images and no recordings"),
        ((str(tmp_path / "black"),), "0.png: black, or smaller than 16 pixels"),
        ((plain, "limit=3"), "limit: Input should be greater than or equal to 4"),
        ((plain, f"models=[{tmp_path / 'none'}]"), "models: "),
        ((plain, "pictures=[{name: mine, dir: none}]"), "pictures: mine: none: 1 of 1"),
    ):
        assert main(["evaluate", "real", *words, f"out={tmp_path / 'out'}", "workers=1"]) == 2
        error = capsys.readouterr().err
        assert message in error


def test_no_copy_of_a_frame_is_its_reference(tmp_path: Path) -> None:
    """A slow sonar in a fast video, saved frame by frame without leading zeros."""
    folder = tmp_path / "real"
    folder.mkdir()
    frames = [image for image in stored(3, 8) for _ in range(2)]
    for number, image in enumerate(frames):
        assert cv2.imwrite(str(folder / f"frame{number}.png"), image)
    (stretch,), _ = open_input(str(folder))
    names = [shot.name for shot in stretch.shots]
    assert names == [f"frame{number}.png" for number in range(16)]
    (group,), shots, notes = search((0, stretch, None))
    assert [shot.name for shot in group.shots] == names[::2]
    assert len(shots) == 8
    assert notes == ["real: 8 frames left out that are copies of others"]
