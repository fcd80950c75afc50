"""Every row on every recording: insert targets, denoise both sequences, ask the detectors."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Bools
from ...factory.common.errors import FactoryError
from ...factory.common.progress import Bar
from ...factory.common.seeds import stream
from ...factory.common.workers.tasks import TaskLost, TaskPool
from ...factory.dataset.fan_geometry import FanGeometry
from ..judging.learned import learned_notes
from ..judging.methods import baselines_of, networks_at, reason, shown
from ..judging.recorded import Stretch
from ..judging.settings import TargetsSettings
from ..metrics.measure import Figures, Grey, ratio_figures
from ..metrics.statistics import evenly
from .detector import Responses, real_motion, responses_of
from .recording import StaticRecording, open_static
from .rows import REACH, RECORDED, MethodRow, Stored, denoise_sequence, rows_of
from .scores import Answers, MethodFigures, figures_of
from .targets import Sighting, Track, TrackPlan, classes_of, draw_tracks, insert_targets

_RATIO_FRAMES = 5  # frames of a sequence whose ratio images are measured


@dataclass(frozen=True, eq=False)
class TwinSequences:
    """A recording with targets, its twin without, and what both are judged by.

    with_targets, without: as the recording stores frames.  motion: (N, H, W) bool, real motion.
    """

    name: str
    with_targets: Stored
    without: Stored
    full_scale: int
    geometry: FanGeometry | None
    tracks: tuple[Track, ...]
    insonified: Bools
    motion: Bools

    @property
    def judged(self) -> range:
        """Numbers of the frames whose sightings count: those with a whole window."""
        return range(REACH + 1, len(self.with_targets) - REACH - 1)


class TwinImages(NamedTuple):
    """A denoised frame, (H, W) float32 in 0..1, with targets and without."""

    with_targets: Grey
    without: Grey


@dataclass(frozen=True, eq=False)
class SightingExample:
    """A sighting that the report shows.  images: label of a row -> its images of the frame."""

    sequence_number: int
    track: Track
    sighting: Sighting
    images: dict[str, TwinImages]


@dataclass(frozen=True, eq=False)
class DetectionOutcome:
    """The figures of all rows on all recordings.

    figures: label of a row -> its figures.  lost: label -> why a row has none.
    ratios: label -> figures of its ratio images, means over the sequences.
    """

    sequences: list[TwinSequences]
    figures: dict[str, MethodFigures]
    ratios: dict[str, Figures]
    lost: dict[str, str]
    examples: list[SightingExample]
    notes: list[str]


@dataclass(frozen=True, eq=False)
class DetectionTask:
    """A row to run on one pair of sequences; it travels to a worker.

    example_frames: numbers of the frames whose denoised images come back.
    """

    sequence_number: int
    row: MethodRow
    twins: TwinSequences
    device: str
    example_frames: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class DetectionResult:
    """What a row gave on one pair of sequences.

    responses: None if the row failed; `lost` gives the reason.
    images: number of a frame -> its images.
    ratio: figures of the ratio images, means over some frames.
    """

    responses: Responses | None
    images: dict[int, TwinImages] = field(default_factory=dict)
    ratio: Figures = field(default_factory=dict)
    lost: str = ""


Results = dict[tuple[int, str], DetectionResult]
"""(number of the sequences, label of the row) -> result."""


def judge(
    settings: TargetsSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> DetectionOutcome:
    """Judge every row on every recording.  Raises FactoryError where no recording can be judged."""
    networks = networks_at(settings.models)
    recordings, notes = _static_recordings(stretches, settings.limit)
    notes += learned_notes(stretches, networks)
    sequences: list[TwinSequences] = []
    rows_of_sequence: list[list[MethodRow]] = []
    for recording in recordings:
        rows = rows_of(
            recording.frames,
            recording.insonified,
            fixed=settings.fixed,
            tuned=baselines_of(settings.baselines),
            networks=networks,
            windows=settings.frames,
        )
        notes.append(_tuning_note(recording.name, rows))
        for repeat in range(settings.repeats):
            sequences.append(_insert_tracks(recording, settings, repeat))
            rows_of_sequence.append(rows)

    examples = _choose_examples(sequences, settings)
    tasks: list[DetectionTask] = []
    for number, (twins, rows) in enumerate(zip(sequences, rows_of_sequence, strict=True)):
        frames = {
            example.sighting.frame for example in examples if example.sequence_number == number
        }
        tasks += [DetectionTask(number, row, twins, settings.device, tuple(frames)) for row in rows]
    results, lost = _run_tasks(tasks, pool, settings.image_timeout_s * len(recordings[0].frames))

    every_label = dict.fromkeys(task.row.label for task in tasks)
    labels = [label for label in every_label if label not in lost]
    for example in examples:
        for label in labels:
            images = results[example.sequence_number, label].images
            example.images[label] = images[example.sighting.frame]
    ratios = {
        label: _mean_figures([results[number, label].ratio for number in range(len(sequences))])
        for label in labels
    }
    figures = {label: _row_figures(label, results, sequences, settings) for label in labels}
    return DetectionOutcome(sequences, figures, ratios, lost, examples, notes)


def run_row(task: DetectionTask) -> DetectionResult:
    """Denoise both sequences and ask the detectors; or say why the row failed."""
    twins = task.twins
    try:
        with_targets, without = (
            denoise_sequence(task.row, stored, twins.full_scale, twins.geometry, task.device)
            for stored in (twins.with_targets, twins.without)
        )
    except Exception as error:  # a method that crashes loses its row, not the report
        return DetectionResult(None, lost=reason(error))
    responses = responses_of(
        with_targets, without, twins.tracks, twins.insonified, twins.motion, twins.judged
    )
    images = {
        number: TwinImages(with_targets[number], without[number]) for number in task.example_frames
    }
    full_scale = np.float32(twins.full_scale)
    ratios = [
        ratio_figures(
            twins.with_targets[number] / full_scale, with_targets[number], twins.insonified
        )
        for number in evenly(twins.judged, _RATIO_FRAMES)
    ]
    return DetectionResult(responses, images, _mean_figures(ratios))


def _mean_figures(figures: Sequence[Figures]) -> Figures:
    """The mean of each figure."""
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
        others = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise FactoryError(problems[0] + others)
    return recordings, [f"left out: {problem}" for problem in problems]


def _insert_tracks(
    recording: StaticRecording, settings: TargetsSettings, repeat: int
) -> TwinSequences:
    """A recording with targets, and its twin.  Raises FactoryError where no track finds room."""
    plan = TrackPlan(
        classes_of(settings.sizes, settings.contrasts),
        at_once=settings.tracks,
        frames=settings.track_frames,
        speed_px=settings.speed_px,
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
    twin_frames = without.astype(np.float32) / np.float32(recording.full_scale)
    return TwinSequences(
        name=recording.name,
        with_targets=recording.stored(inserted.with_targets),
        without=without,
        full_scale=recording.full_scale,
        geometry=recording.geometry,
        tracks=tuple(tracks),
        insonified=recording.insonified,
        motion=real_motion(twin_frames, recording.insonified),
    )


def _choose_examples(
    sequences: Sequence[TwinSequences], settings: TargetsSettings
) -> list[SightingExample]:
    """The middle sighting of the first track of each class, sequences taking turns."""
    examples: list[SightingExample] = []
    classes = evenly(classes_of(settings.sizes, settings.contrasts), settings.examples)
    for turn, target in enumerate(classes):
        number = turn % len(sequences)
        twins = sequences[number]
        for track in twins.tracks:
            middle = track.sightings[len(track.sightings) // 2]
            if track.target == target and middle.frame in twins.judged:
                examples.append(SightingExample(number, track, middle, {}))
                break
    return examples


def _tuning_note(name: str, rows: Sequence[MethodRow]) -> str:
    """Which parameters the tuned rows of a recording have."""
    tuned = [row for row in rows if row.kind != "filter" or row.label.endswith("tuned")]
    texts = [row.label + shown(row.parameters) for row in tuned if row.parameters]
    return f"{name}: tuned to the recording without targets: {'; '.join(texts)}"


def _run_tasks(
    tasks: Sequence[DetectionTask], pool: TaskPool, timeout_s: float
) -> tuple[Results, dict[str, str]]:
    """The results; and label -> why a row is lost."""
    results: Results = {}
    lost: dict[str, str] = {}
    # The slowest first, so that no worker is left with it at the end.
    waiting = deque(sorted(tasks, key=lambda task: (-task.row.frames, task.row.kind != "network")))
    with Bar(total=len(tasks), unit="row", desc="detecting") as bar:
        for task, result in pool.run(run_row, waiting, lambda _: timeout_s):
            bar.update()
            if isinstance(result, TaskLost):
                lost.setdefault(task.row.label, result.reason)
            elif result.responses is None:
                lost.setdefault(task.row.label, result.lost)
            else:
                results[task.sequence_number, task.row.label] = result
    if RECORDED.label in lost:
        raise FactoryError(f"the recorded frames cannot be judged: {lost[RECORDED.label]}")
    return results, lost


def _row_figures(
    label: str, results: Results, sequences: Sequence[TwinSequences], settings: TargetsSettings
) -> MethodFigures:
    answers = []
    for number, twins in enumerate(sequences):
        denoised = results[number, label].responses
        recorded = results[number, RECORDED.label].responses
        assert denoised is not None
        assert recorded is not None
        answers.append(Answers(twins.tracks, denoised, recorded))
    classes = classes_of(settings.sizes, settings.contrasts)
    return figures_of(answers, classes, resamples=settings.bootstrap, seed=settings.seed)
