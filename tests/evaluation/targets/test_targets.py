"""`simnfnd evaluate targets`: inserted targets, what detectors answer, the report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.targets.detector import Responses, real_motion, responses_of
from simnfnd.evaluation.targets.scores import (
    Answers,
    MethodFigures,
    count_wins,
    figures_of,
    threshold_of,
)
from simnfnd.evaluation.targets.targets import (
    Frames,
    Insertion,
    TrackPlan,
    blurred,
    classes_of,
    draw_tracks,
    insert_targets,
)

HEIGHT = 150
WIDTH = 170
COUNT = 28
CLASSES = classes_of([(3, 2), (6, 3)], [1, 4])
PLAN = TrackPlan(CLASSES, at_once=4, frames=7, speed_px=(1, 2))


def recording(count: int = COUNT, step_px: float = 0, level: float = 0.3) -> Frames:
    """A scene with blobs under fresh grain; step_px: how far it moves from frame to frame."""
    rng = np.random.default_rng(0)
    wide = WIDTH + int(step_px * count) + 1
    blobs = blurred(rng.normal(0, 1, (HEIGHT, wide)).astype(np.float32), 5)
    scene = level * (1 + 0.8 * np.clip(blobs / blobs.std(), -1, 1))
    frames = []
    for number in range(count):
        left = int(step_px * number)
        grain = blurred(rng.normal(0, 1, (HEIGHT, WIDTH)).astype(np.float32), 0.7)
        frames.append(scene[:, left : left + WIDTH] * (1 + 0.3 * grain / grain.std()))
    return np.asarray(np.clip(np.stack(frames), 0, 1), np.float32)


def saved(folder: Path, frames: Frames) -> Path:
    folder.mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"{number:03d}.png"), np.rint(frame * 255).astype(np.uint8))
    return folder


INSONIFIED = np.zeros((HEIGHT, WIDTH), bool)
INSONIFIED[15:-15, 15:-15] = True


@pytest.fixture(scope="module")
def frames() -> Frames:
    return recording()


@pytest.fixture(scope="module")
def insertion(frames: Frames) -> Insertion:
    rng = np.random.default_rng(1)
    tracks = draw_tracks(INSONIFIED, COUNT, PLAN, rng)
    return insert_targets(frames, INSONIFIED, tracks, rng)


def answers(insertion: Insertion, with_targets: Frames, without: Frames) -> Responses:
    motion = real_motion(insertion.without, INSONIFIED)
    judged = range(4, COUNT - 4)
    return responses_of(with_targets, without, insertion.tracks, INSONIFIED, motion, judged)


def figures(insertion: Insertion, denoised: Responses, recorded: Responses) -> MethodFigures:
    own = [Answers(insertion.tracks, denoised, recorded)]
    return figures_of(own, CLASSES, resamples=200, seed=0)


# --- targets --------------------------------------------------------------------------------------


def test_tracks_stay_inside_and_apart(insertion: Insertion) -> None:
    tracks = insertion.tracks
    assert {track.target for track in tracks} == set(CLASSES)
    for track in tracks:
        steps = np.diff([[sighting.y, sighting.x] for sighting in track.sightings], axis=0)
        speed = np.linalg.norm(steps, axis=1)
        assert speed.min() >= 1 - 1e-9
        assert speed.max() <= 2 + 1e-9
        assert np.allclose(steps, steps[0])
        assert all(INSONIFIED[int(sighting.y), int(sighting.x)] for sighting in track.sightings)
    first = [track for track in tracks if track.sightings[0].frame == 0]
    for number, track in enumerate(first):
        assert all(track.is_apart_from(track_before) for track_before in first[:number])


def test_sequences_differ_in_contrast_alone(frames: Frames, insertion: Insertion) -> None:
    added = insertion.with_targets - insertion.without
    near = np.zeros(frames.shape, bool)
    rows, columns = np.ogrid[:HEIGHT, :WIDTH]
    centres: dict[float, list[float]] = {1: [], 4: []}
    for track in insertion.tracks:
        for number, y, x in track.sightings:
            near[number] |= np.hypot(rows - y, columns - x) < 2 * max(track.target.semi_axes_px)
            centres[track.target.contrast].append(float(added[number, round(y), round(x)]))
    assert added.min() > -1e-6
    np.testing.assert_allclose(insertion.with_targets[~near], frames[~near], atol=1e-6)
    np.testing.assert_allclose(insertion.without[~near], frames[~near], atol=1e-6)
    assert np.mean(centres[4]) == pytest.approx(4 * np.mean(centres[1]), rel=0.15)


# --- detectors and scores -------------------------------------------------------------------------


def test_recorded_frames_retain_all_and_a_twin_nothing(insertion: Insertion) -> None:
    recorded = answers(insertion, insertion.with_targets, insertion.without)
    same = figures(insertion, recorded, recorded)
    assert same.overall.contrast.value == pytest.approx(1)
    assert same.overall.detection_gain.value == 0
    assert same.false_alarms.value == pytest.approx(1)
    faint = same.by_class[0]
    bright = same.by_class[3]
    assert 0.5 < faint.auc.value < bright.auc.value
    assert bright.detection.value > 0.9
    erased = answers(insertion, insertion.without, insertion.without)
    nothing = figures(insertion, erased, recorded)
    assert nothing.overall.contrast.value == pytest.approx(0, abs=1e-6)
    assert nothing.overall.auc.value == pytest.approx(0.5)
    assert nothing.overall.detection_gain.high < 0
    assert nothing.overall.detection.value < 0.1


def test_a_mean_in_time_loses_moving_targets(insertion: Insertion) -> None:
    def mean(sequence: Frames) -> Frames:
        return np.stack([sequence[max(0, n - 3) : n + 4].mean(axis=0) for n in range(COUNT)])

    recorded = answers(insertion, insertion.with_targets, insertion.without)
    fused = answers(insertion, mean(insertion.with_targets), mean(insertion.without))
    actual = figures(insertion, fused, recorded)
    small = actual.by_class[1].contrast
    large = actual.by_class[3].contrast
    assert 0.1 < small.value < large.value < 0.9


def test_intervals_draw_tracks_not_frames(insertion: Insertion) -> None:
    recorded = answers(insertion, insertion.with_targets, insertion.without)
    often = replace(
        recorded,
        track=np.repeat(recorded.track, 9),
        present=np.repeat(recorded.present, 9),
        absent=np.repeat(recorded.absent, 9),
        change=np.repeat(recorded.change, 9),
    )
    once = figures(insertion, recorded, recorded).overall
    repeated = figures(insertion, often, often).overall
    assert once.detection.low < once.detection.value < once.detection.high
    np.testing.assert_allclose(repeated.detection, once.detection)
    np.testing.assert_allclose(repeated.auc, once.auc)


def test_the_threshold_lets_so_many_alarms_through() -> None:
    height = np.arange(100.0)
    none = np.empty(0)
    responses = Responses(none.astype(int), none, none, none, height.astype(int), height, 10)
    assert (height >= threshold_of(responses, 1.0)).sum() == 10
    assert (height >= threshold_of(responses, 0.5)).sum() == 5
    assert threshold_of(responses, 0.01) == np.inf
    assert threshold_of(responses, 50) == 0


@pytest.mark.parametrize(
    ("present", "absent", "area"), [([2, 3], [0, 1], 1), ([0, 1], [2, 3], 0), ([1, 2], [1, 2], 0.5)]
)
def test_auc(present: list[float], absent: list[float], area: float) -> None:
    pairs = len(present) * len(absent)
    assert count_wins(np.array(present), np.array(absent)) / pairs == area


# --- the command ----------------------------------------------------------------------------------

SMALL = (
    "sizes=[[3,2],[6,3]]", "contrasts=[1,4]", "speed_px=[1,2]", "track_frames=7",
    "tracks=4", "bootstrap=100", "workers=1",
)  # fmt: skip


@pytest.mark.slow
def test_the_report(tmp_path: Path, frames: Frames, capsys: pytest.CaptureFixture[str]) -> None:
    folder = saved(tmp_path / "dive", frames)
    out = tmp_path / "out"
    words = [str(folder), *SMALL, "frames=[1]", "fixed=[{gaussian:{sigma_px:1.5}}]", "baselines=[]"]
    assert main(["evaluate", "targets", *words, f"out={out}"]) == 0
    assert "| recorded |" in capsys.readouterr().out
    content: dict[str, Any] = json.loads((out / "targets.json").read_text(encoding="utf-8"))
    rows = {row["label"]: row for row in content["rows"]}
    assert list(rows) == [
        "recorded", "gaussian (sigma_px=1.5)", "mean of 7", "registered mean of 7 + TV",
        "simnfnd, single frames",
    ]  # fmt: skip
    assert rows["recorded"]["contrast"]["value"] == pytest.approx(1)
    assert rows["mean of 7"]["contrast"]["value"] < 0.9
    assert not content["lost"]
    sheet = cv2.imread(str(out / "crops.png"))
    assert sheet is not None
    assert sheet.std() > 10
    curves = (out / "curves.svg").read_text(encoding="utf-8")
    assert all(curves.count(f">{label}<") == 1 for label in rows)
    page = (out / "targets.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 2
    assert "targets.html" not in page


@pytest.mark.parametrize(
    ("recording_options", "words"),
    [
        ({"step_px": 3}, "moves"),
        ({"count": 12}, "12 frames"),
        ({"level": 0}, "insonified"),
    ],
)
def test_recordings_that_do_not_suit_get_one_line(
    tmp_path: Path,
    recording_options: dict[str, float],
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = saved(tmp_path / "dive", recording(**recording_options))  # type: ignore[arg-type]
    assert main(["evaluate", "targets", str(folder), *SMALL, f"out={tmp_path / 'out'}"]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error
    assert "\n" not in error


@pytest.mark.parametrize(
    "word", ["fixed=[{gauss:{sigma_px:1}}]", "fixed=[{gaussian:{sigma:1}}]", "speed_px=[0,1]"]
)
def test_wrong_keys_are_named(
    tmp_path: Path, frames: Frames, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = saved(tmp_path / "dive", frames[:20])
    words = [str(folder), *SMALL, word, "models=[]", f"out={tmp_path / 'out'}"]
    assert main(["evaluate", "targets", *words]) == 2
    assert word.partition("=")[0] in capsys.readouterr().err
