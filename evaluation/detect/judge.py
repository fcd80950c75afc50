"""Every row on every recording: insert targets, denoise both sequences, ask the detectors."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ...factory.seeds import stream
from ...factory.sonar.geometry import FanGeometry
from ..learned import learned_notes
from ..methods import baselines_of, networks_at, reason, shown
from ..metrics.fidelity import Mask
from ..metrics.measure import Figures, Grey, ratio_figures
from ..metrics.statistics import evenly
from ..recorded import Stretch
from ..settings import DetectSettings
from .detector import Responses, real_motion, responses_of
from .recording import StaticRecording, open_static
from .rows import REACH, RECORDED, Row, Stored, denoised, rows_of
from .scores import Answers, MethodFigures, figures_of
from .targets import Sighting, Track, TrackPlan, classes_of, draw_tracks, insert_targets


@dataclass(frozen=True, eq=False)
class Sequences:
    """A recording with targets, its twin without, and what both are judged by.

    with_targets, without: as the recording stores frames.  motion: (N, H, W) bool, real motion.
    """

    name: str
    with_targets: Stored
    without: Stored
    full_scale: int
    geometry: FanGeometry | None
    tracks: tuple[Track, ...]
    insonified: Mask
    motion: Mask

    @property
    def judged(self) -> range:
        """The frames whose sightings count: they have a whole window."""
        return range(REACH + 1, len(self.with_targets) - REACH - 1)


_RATIO_FRAMES = 5  # of a sequence, whose ratio images are measured


class Images(NamedTuple):
    """A frame, (H, W) float32 in 0..1, with targets and without."""

    with_targets: Grey
    without: Grey


@dataclass(frozen=True, eq=False)
class Example:
    """A sighting to look at.

    sequence: its number.  images: label of a row -> what it made of the frame.
    """

    sequence: int
    track: Track
    sighting: Sighting
    images: dict[str, Images]


@dataclass(frozen=True, eq=False)
class Outcome:
    """figures: label of a row -> its figures.  lost: label -> why there are none.

    ratios: label -> figures of its ratio images, means over the sequences.
    """

    sequences: list[Sequences]
    figures: dict[str, MethodFigures]
    ratios: dict[str, Figures]
    lost: dict[str, str]
    examples: list[Example]
    notes: list[str]


@dataclass(frozen=True, eq=False)
class Task:
    """A row on a sequence; it travels to a worker.  shown: frames whose images come back."""

    sequence: int
    row: Row
    sequences: Sequences
    device: str
    shown: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Result:
    """responses: or None and why.  images: number of a frame -> its images, and its twin's.

    ratio: mean figures of the ratio images of some frames.
    """

    responses: Responses | None
    images: dict[int, Images]
    ratio: Figures = field(default_factory=dict)
    lost: str = ""


def judge(settings: DetectSettings, stretches: Sequence[Stretch], pool: TaskPool) -> Outcome:
    """All figures.  Raises FactoryError where no recording can be judged."""
    networks = networks_at(settings.models)
    recordings, notes = _static_recordings(stretches, settings.limit)
    notes += learned_notes(stretches, networks)
    sequences: list[Sequences] = []
    rows_by_sequence: list[list[Row]] = []
    for recording in recordings:
        rows = rows_of(
            recording.frames,
            fixed=settings.fixed,
            tuned=baselines_of(settings.baselines),
            networks=networks,
            windows=settings.frames,
        )
        notes += _tuning_notes(recording.name, rows)
        for repeat in range(settings.repeats):
            sequences.append(_with_targets(recording, settings, repeat))
            rows_by_sequence.append(rows)
    examples = _examples(sequences, settings)
    tasks: list[Task] = []
    for number, rows in enumerate(rows_by_sequence):
        frames = tuple(
            {example.sighting.frame for example in examples if example.sequence == number}
        )
        tasks += [Task(number, row, sequences[number], settings.device, frames) for row in rows]
    results, lost = _run(tasks, pool, settings.image_timeout_s * len(recordings[0].frames))
    labels = dict.fromkeys(task.row.label for task in tasks)
    figures = {
        label: _figures(label, results, sequences, settings)
        for label in labels
        if label not in lost
    }
    for example in examples:
        for label in figures:
            images = results[example.sequence, label].images
            example.images[label] = images[example.sighting.frame]
    ratios = {
        label: _mean_figures([results[number, label].ratio for number in range(len(sequences))])
        for label in figures
    }
    return Outcome(sequences, figures, ratios, lost, examples, notes)


def run_row(task: Task) -> Result:
    """Denoise both sequences and ask the detectors; or say why the row failed."""
    both = task.sequences
    try:
        with_targets, without = (
            denoised(task.row, stored, both.full_scale, both.geometry, task.device)
            for stored in (both.with_targets, both.without)
        )
    except Exception as error:  # a method that crashes loses its row, not the report
        return Result(None, {}, lost=reason(error))
    responses = responses_of(
        with_targets, without, both.tracks, both.insonified, both.motion, both.judged
    )
    images = {number: Images(with_targets[number], without[number]) for number in task.shown}
    full = np.float32(both.full_scale)
    ratios = [
        ratio_figures(both.with_targets[number] / full, with_targets[number], both.insonified)
        for number in evenly(both.judged, _RATIO_FRAMES)
    ]
    return Result(responses, images, _mean_figures(ratios))


def _mean_figures(figures: Sequence[Figures]) -> Figures:
    return {name: float(np.mean([single[name] for single in figures])) for name in figures[0]}


def _static_recordings(
    stretches: Sequence[Stretch], frame_limit: int
) -> tuple[list[StaticRecording], list[str]]:
    """The recordings that can be judged, and why others cannot."""
    recordings: list[StaticRecording] = []
    problems: list[str] = []
    for stretch in stretches:
        try:
            recordings.append(open_static(stretch, frame_limit))
        except FactoryError as error:
            problems.append(str(error))
    if not recordings:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise FactoryError(problems[0] + more)
    return recordings, [f"left out: {problem}" for problem in problems]


def _with_targets(recording: StaticRecording, settings: DetectSettings, repeat: int) -> Sequences:
    """Raises FactoryError where no track finds room."""
    plan = TrackPlan(
        classes_of(settings.sizes, settings.contrasts),
        settings.tracks,
        settings.track_frames,
        settings.speed_px,
    )
    rng = stream(settings.seed, "targets", recording.name, repeat)
    tracks = draw_tracks(recording.insonified, len(recording.frames), plan, rng)
    if not tracks:
        raise FactoryError(
            f"{recording.name}: no target finds room in the insonified area; lower speed_px or "
            "track_frames"
        )
    inserted = insert_targets(recording.frames, recording.insonified, tracks, rng)
    without = recording.stored(inserted.without)
    twin = without.astype(np.float32) / np.float32(recording.full_scale)
    return Sequences(
        recording.name,
        recording.stored(inserted.with_targets),
        without,
        recording.full_scale,
        recording.geometry,
        tuple(tracks),
        recording.insonified,
        real_motion(twin, recording.insonified),
    )


def _examples(sequences: Sequence[Sequences], settings: DetectSettings) -> list[Example]:
    """Of each class the middle sighting of its first track, recordings taking turns."""
    examples: list[Example] = []
    classes = evenly(classes_of(settings.sizes, settings.contrasts), settings.examples)
    for turn, target in enumerate(classes):
        number = turn % len(sequences)
        both = sequences[number]
        for track in both.tracks:
            middle = track.sightings[len(track.sightings) // 2]
            if track.target == target and middle.frame in both.judged:
                examples.append(Example(number, track, middle, {}))
                break
    return examples


def _tuning_notes(name: str, rows: Sequence[Row]) -> list[str]:
    tuned = [row for row in rows if row.kind != "filter" or row.label.endswith("tuned")]
    words = [row.label + shown(row.parameters) for row in tuned if row.parameters]
    return [f"{name}: tuned to the recording without targets: {'; '.join(words)}"]


def _run(
    tasks: Sequence[Task], pool: TaskPool, timeout_s: float
) -> tuple[dict[tuple[int, str], Result], dict[str, str]]:
    """(sequence, label) -> result; and label -> why a row is lost."""
    results: dict[tuple[int, str], Result] = {}
    lost: dict[str, str] = {}
    # The slowest first, so that no worker is left with it at the end.
    waiting = deque(sorted(tasks, key=lambda task: (-task.row.frames, task.row.kind != "network")))
    with progress_bar(total=len(tasks), unit="row", desc="detecting") as bar:
        for task, result in pool.run(run_row, waiting, lambda _: timeout_s):
            bar.update()
            if isinstance(result, TaskLost):
                lost.setdefault(task.row.label, result.reason)
            elif result.responses is None:
                lost.setdefault(task.row.label, result.lost)
            else:
                results[task.sequence, task.row.label] = result
    if RECORDED.label in lost:
        raise FactoryError(f"the recorded frames cannot be judged: {lost[RECORDED.label]}")
    return results, lost


def _figures(
    label: str,
    results: dict[tuple[int, str], Result],
    sequences: Sequence[Sequences],
    settings: DetectSettings,
) -> MethodFigures:
    answers = []
    for number, both in enumerate(sequences):
        own = results[number, label].responses
        recorded = results[number, RECORDED.label].responses
        assert own is not None
        assert recorded is not None
        answers.append(Answers(both.tracks, own, recorded))
    classes = classes_of(settings.sizes, settings.contrasts)
    return figures_of(answers, classes, resamples=settings.bootstrap, seed=settings.seed)
