"""The arms of the comparison: which images each detector learns from, and what it then finds."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.common.errors import FactoryError
from ...factory.common.progress import stage
from ...models.detection import find_detector
from ...models.detection.detector import Detections, detect_in
from ...models.detection.images import UNKNOWN, WorkingImage, scale_image
from ...models.detection.runtime import DetectorRuntime
from ...models.detection.training import BatchShare, Schedule, train_detector
from ...models.detection.weights import TrainedDetector, read_facts
from ..judging.settings import TransferReportSettings
from .blobs import detect_blobs
from .coco import RealImages
from .scores import countable
from .simulated import LabelRules, read_simulated, simulated_classes

BLOB = "blob detector, no training"
SIMULATION = "simulation alone"
_FINE_TUNING_RATE = 0.5  # of the learning rate, where a detector goes on from other weights
_SIMULATED_SHARE = 0.5  # of every batch, where real images are added to simulated ones


@dataclass(frozen=True, eq=False)
class Arm:
    """What one kind of detector finds.

    learns_from: what it learns from, in words.
    detections: for each real image those that count.
    has_classes: whether its detections have the classes of the real images.
    """

    label: str
    learns_from: str
    detections: Sequence[Detections]
    has_classes: bool = True


@dataclass(eq=False)
class Comparison:
    """The arms of one run and where they keep their trainings.

    simulated: images with labels, to learn from; empty where a trained detector is judged.
    held_out: simulated images that no detector learned from.
    """

    settings: TransferReportSettings
    real: RealImages
    simulated: Sequence[WorkingImage] = ()
    held_out: Sequence[WorkingImage] = ()
    trained: TrainedDetector | None = None
    _working: list[WorkingImage] = field(default_factory=list)

    @property
    def working(self) -> list[WorkingImage]:
        """The real images at the size of the detector."""
        if not self._working:
            self._working = [scale_image(image.labelled) for image in self.real.images]
        return self._working

    def arms(self) -> Iterator[Arm]:
        """One arm after another, as its trainings end.  Raises FactoryError."""
        settings = self.settings
        if "blob" in settings.arms:
            detections = self._countable(detect_blobs(self.working))
            yield Arm(BLOB, "nothing", detections, has_classes=False)
        if settings.detector is not None:
            yield self._given(settings.detector)
            return
        if {"simulation", "both"} & set(settings.arms):
            self.trained = self.train_simulated()
        if "simulation" in settings.arms and self.trained is not None:
            detections = self._find(self.trained.path, range(len(self.working)))
            about = f"{len(self.simulated)} simulated images"
            yield Arm(SIMULATION, about, self._countable(detections))
        for share in settings.shares:
            if "real" in settings.arms:
                yield self._cross_validated(share, after_simulation=False)
            if "both" in settings.arms:
                yield self._cross_validated(share, after_simulation=True)

    def _given(self, name: str) -> Arm:
        """The arm of a detector that was trained before."""
        path = find_detector(name)
        detections = self._find(path, range(len(self.working)))
        about = str(read_facts(path).training.get("about", "not stated"))
        return Arm(f"detector {path.stem}", about, self._countable(detections))

    def train_simulated(self) -> TrainedDetector:
        """The detector of simulation alone, or that which the folder holds."""
        settings = self.settings
        stage(f"{SIMULATION}: {len(self.simulated)} images, {settings.steps} steps")
        facts = {
            "about": f"{len(self.simulated)} simulated images",
            "padding": settings.padding,
            "margin": settings.margin,
            "simulated": digest_of(self.simulated),
        }
        schedule = Schedule(settings.steps, settings.batch, settings.learning_rate, settings.seed)
        return train_detector(
            settings.folder / "simulation",
            [BatchShare(self.simulated, 1.0, settings.clutter)],
            self.real.classes,
            schedule,
            facts,
            label=SIMULATION,
        )

    def _cross_validated(self, share: float, *, after_simulation: bool) -> Arm:
        """Detectors that saw a share of the real images of the other folds."""
        words = f"{100 * share:g} % of real labels"
        label = f"simulation, then {words}" if after_simulation else words
        detections_of_image: dict[int, Detections] = {}
        counts = []
        for number, judged in enumerate(folds_of(self._groups(), self.settings.folds)):
            others = [i for i in range(len(self.working)) if i not in set(judged)]
            learned = thin_groups(others, self._groups(), share)
            counts.append(len(learned))
            stage(f"{label}: fold {number + 1} of {self.settings.folds}, {len(learned)} images")
            trained = self._train_real(learned, number, share, after_simulation)
            detections_of_image |= dict(zip(judged, self._find(trained.path, judged), strict=True))
        about = f"{min(counts)} to {max(counts)} real images"
        if after_simulation:
            about = f"{len(self.simulated)} simulated images, then {about} beside them"
        in_order = [detections_of_image[number] for number in range(len(self.working))]
        return Arm(label, about, self._countable(in_order))

    def _train_real(
        self, learned: Sequence[int], fold: int, share: float, after_simulation: bool
    ) -> TrainedDetector:
        settings = self.settings
        images = [self.working[number] for number in learned]
        sources = [BatchShare(images, 1.0, with_clutter=False)]
        facts: dict[str, Any] = {"real": digest_of(images)}
        rate = settings.learning_rate
        if after_simulation:
            sources[0] = BatchShare(images, 1 - _SIMULATED_SHARE, with_clutter=False)
            sources.append(BatchShare(self.simulated, _SIMULATED_SHARE, settings.clutter))
            facts["simulated"] = digest_of(self.simulated)
            rate *= _FINE_TUNING_RATE
        kind = "both" if after_simulation else "real"
        return train_detector(
            settings.folder / f"{kind}-{100 * share:g}" / f"fold-{fold + 1}",
            sources,
            self.real.classes,
            Schedule(settings.real_steps, settings.batch, rate, settings.seed),
            facts,
            start=self.trained if after_simulation else None,
            label=f"fold {fold + 1}",
        )

    def _find(self, path: Path, numbers: Sequence[int]) -> list[Detections]:
        """Detections in some real images, with the labels of the real classes."""
        detector = DetectorRuntime(path)
        own = {name: label for label, name in enumerate(self.real.classes)}
        renumbered = np.array([own.get(name, UNKNOWN) for name in detector.facts.classes], np.int64)
        images = [self.real.images[number].labelled.image for number in numbers]
        return [
            Detections(detections.boxes, detections.scores, renumbered[detections.labels])
            for detections in detect_in(detector, images)
        ]

    def _countable(self, detections: Sequence[Detections]) -> list[Detections]:
        return [
            countable(own_detections, image.ignored)
            for own_detections, image in zip(detections, self.real.images, strict=True)
        ]

    def _groups(self) -> list[str]:
        return [image.labelled.group for image in self.real.images]


def open_training(settings: TransferReportSettings) -> Comparison:
    """A training on a dataset without real images.  Raises FactoryError before any work."""
    folder = settings.dataset.dir
    classes = tuple(settings.classes or ())
    assert folder is not None
    known = simulated_classes(folder)
    for name in classes:
        if name not in known:
            raise FactoryError(f"classes: {folder} has no {name}; it has {', '.join(known)}")
    learned, held_out = read_simulated(folder, classes, rules_of(settings), limit=settings.limit)
    nothing = RealImages(Path(folder).name, (), classes, has_groups=False)
    return Comparison(settings, nothing, learned, held_out)


def open_comparison(settings: TransferReportSettings, real: RealImages) -> Comparison:
    """The images that the arms learn from.  Raises FactoryError before any work."""
    needs_simulation = {"simulation", "both"} & set(settings.arms)
    if settings.detector is not None:
        find_detector(settings.detector)
        return Comparison(settings, real)
    if {"real", "both"} & set(settings.arms):
        group_count = len({image.labelled.group for image in real.images})
        if group_count < settings.folds:
            raise FactoryError(
                f"folds={settings.folds}: {real.name} has {group_count} groups of images, and a "
                "group is never split; give fewer folds, or arms=[blob,simulation]"
            )
    if not needs_simulation:
        return Comparison(settings, real)
    if settings.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `simnfnd make` made before the images")
    known = simulated_classes(settings.dataset.dir)
    shared = [name for name in real.classes if name in known]
    if not shared:
        raise FactoryError(
            f"class_names: no class of {real.name} ({', '.join(real.classes)}) is one of the "
            f"dataset ({', '.join(known)}); map them, as in class_names={{Tyre: Tire}}"
        )
    learned, held_out = read_simulated(
        settings.dataset.dir, real.classes, rules_of(settings), limit=settings.limit
    )
    return Comparison(settings, real, learned, held_out)


def rules_of(settings: TransferReportSettings) -> LabelRules:
    """How the objects of the dataset are labelled."""
    return LabelRules(
        padding=settings.padding,
        with_shadow=tuple(settings.with_shadow),
        min_visibility_db=settings.min_visibility,
        min_side=settings.min_side,
        far_end=settings.far_end,
    )


def folds_of(groups: Sequence[str], fold_count: int) -> list[list[int]]:
    """Numbers of the images of each fold; groups stay whole, folds get about as many images."""
    members: dict[str, list[int]] = {}
    for number, group in enumerate(groups):
        members.setdefault(group, []).append(number)
    folds: list[list[int]] = [[] for _ in range(fold_count)]
    for group in sorted(members, key=lambda name: (-len(members[name]), name)):
        min(folds, key=len).extend(members[group])
    return [sorted(fold) for fold in folds]


def thin_groups(numbers: Sequence[int], groups: Sequence[str], share: float) -> list[int]:
    """A share of some images, evenly from all of their groups, as a person would label them."""
    if share >= 1:
        return list(numbers)
    in_groups = sorted(numbers, key=lambda number: (groups[number], number))
    count = max(1, round(share * len(in_groups)))
    places = (np.arange(count) + 0.5) * len(in_groups) / count
    return sorted(in_groups[int(place)] for place in places)


def digest_of(images: Sequence[WorkingImage]) -> str:
    """16 hex digits that change with any image, box or label."""
    digest = hashlib.sha256()
    for working in images:
        for array in (working.labelled.image, working.labelled.boxes, working.labelled.labels):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
