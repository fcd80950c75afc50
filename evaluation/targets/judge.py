"""Every row on every recording: insert targets, denoise both sequences, ask the detectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Bools
from ...factory.common.errors import FactoryError
from ...factory.common.progress import Bar
from ...factory.common.seeds import stream
from ...factory.common.workers.tasks import TaskPool
from ...factory.dataset.fan_geometry import FanGeometry
from ..judging.learned import learned_notes
from ..judging.methods import Method, baselines_of, networks_at, shown
from ..judging.recorded import Stretch
from ..judging.runner import Denoised, Measured, Subject, run
from ..judging.sequences import SequenceMethod
from ..judging.settings import TargetsSettings
from ..metrics.measure import Figures, Grey, ratio_figures
from ..metrics.statistics import evenly
from .detector import real_motion, responses_of
from .recording import StaticRecording, open_static
from .rows import REACH, RECORDED, Stored, denoise_stored, rows_of
from .scores import Answers, MethodFigures, figures_of
from .targets import Frames, Sighting, Track, TrackPlan, classes_of, draw_tracks, insert_targets

_RATIO_FRAMES = 5  # frames of a sequence whose ratio images are measured


@dataclass(frozen=True, eq=False)
class TwinSequences(Subject):
    """A recording with targets, its twin without, and what both are judged by.

    fold: number of the recording.
    with_targets, without: as the recording stores frames.  motion: (N, H, W) bool, real motion.
    example_frames: numbers of the frames whose denoised images the report shows.
    """

    name: str
    with_targets: Stored
    without: Stored
    full_scale: int
    geometry: FanGeometry | None
    tracks: tuple[Track, ...]
    insonified: Bools
    motion: Bools
    fold: int = 0
    example_frames: tuple[int, ...] = ()

    @property
    def images(self) -> int:
        """See `Subject`."""
        return 2 * len(self.with_targets)

    @property
    def judged(self) -> range:
        """Numbers of the frames whose sightings count: those with a whole window."""
        return range(REACH + 1, len(self.with_targets) - REACH - 1)

    def load(self) -> None:
        """See `Subject`; the frames are there."""

    def denoise(self, method: Method, device: str) -> Denoised:
        """See `Subject`: both sequences."""
        assert isinstance(method, SequenceMethod)
        twins = (
            denoise_stored(method, stored, self.full_scale, self.geometry, device, self.fold)
            for stored in (self.with_targets, self.without)
        )
        return Denoised(tuple(twins))

    def measure(self, image: tuple[Frames, Frames]) -> dict[str, Any]:
        """The answers of the detectors, mean figures of ratio images, and images to show."""
        with_targets, without = image
        responses = responses_of(
            with_targets, without, self.tracks, self.insonified, self.motion, self.judged
        )
        scale = np.float32(self.full_scale)
        ratios = [
            ratio_figures(self.with_targets[n] / scale, with_targets[n], self.insonified)
            for n in evenly(self.judged, _RATIO_FRAMES)
        ]
        images = {n: TwinImages(with_targets[n], without[n]) for n in self.example_frames}
        return {"responses": responses, "ratio": _mean_figures(ratios), "images": images}


class TwinImages(NamedTuple):
    """A denoised frame, (H, W) float32 in 0..1, with targets and without."""

    with_targets: Grey
    without: Grey


class SightingExample(NamedTuple):
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


def judge(
    settings: TargetsSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> DetectionOutcome:
    """Judge every row on every recording.  Raises FactoryError where no recording can be judged."""
    networks = networks_at(settings.models)
    recordings, notes = _static_recordings(stretches, settings.limit)
    notes += learned_notes(stretches, networks)
    rows = rows_of(
        recordings,
        fixed=settings.fixed,
        tuned=baselines_of(settings.baselines),
        networks=networks,
        windows=settings.frames,
    )
    notes += [_tuning_note(recording.name, n, rows) for n, recording in enumerate(recordings)]
    sequences = [
        _insert_tracks(recording, settings, fold, repeat)
        for fold, recording in enumerate(recordings)
        for repeat in range(settings.repeats)
    ]
    examples = _choose_examples(sequences, settings)
    subjects = {
        number: replace(
            twins,
            example_frames=tuple(
                example.sighting.frame for example in examples if example.sequence_number == number
            ),
        )
        for number, twins in enumerate(sequences)
    }
    # The slowest first, so that no worker is left with it at the end.
    order = sorted(rows, key=lambda row: (row.weights is None, -row.window))
    with Bar(total=len(rows) * len(sequences), unit="row", desc="detecting") as bar:
        measured = run(
            order,
            [subjects],
            pool,
            device=settings.device,
            timeout_s=settings.image_timeout_s,
            tick=bar.update,
        )
    if RECORDED.label in measured.lost:
        reason = measured.lost[RECORDED.label]
        raise FactoryError(f"the recorded frames cannot be judged: {reason}")

    labels = [row.label for row in rows if row.label not in measured.lost]
    for example in examples:
        for label in labels:
            images = measured.figures[label][example.sequence_number]["images"]
            example.images[label] = images[example.sighting.frame]
    ratios = {
        label: _mean_figures([result["ratio"] for result in measured.figures[label].values()])
        for label in labels
    }
    figures = {label: _row_figures(label, measured, sequences, settings) for label in labels}
    return DetectionOutcome(sequences, figures, ratios, measured.lost, examples, notes)


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
    recording: StaticRecording, settings: TargetsSettings, fold: int, repeat: int
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
        fold=fold,
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


def _tuning_note(name: str, fold: int, rows: Sequence[SequenceMethod]) -> str:
    """Which parameters the tuned rows of a recording have."""
    texts = [row.label + shown(row.parameters_of(fold)) for row in rows if row.folds]
    return f"{name}: tuned to the recording without targets: {'; '.join(texts)}"


def _row_figures(
    label: str, measured: Measured, sequences: Sequence[TwinSequences], settings: TargetsSettings
) -> MethodFigures:
    answers = [
        Answers(
            twins.tracks,
            measured.figures[label][number]["responses"],
            measured.figures[RECORDED.label][number]["responses"],
        )
        for number, twins in enumerate(sequences)
    ]
    classes = classes_of(settings.sizes, settings.contrasts)
    return figures_of(answers, classes, resamples=settings.bootstrap, seed=settings.seed)
