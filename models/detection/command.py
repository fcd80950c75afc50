"""`simnfnd detect`: find objects in images, videos, recordings, bags and datasets."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from ...factory import __version__
from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, sha256_of
from ...factory.common.progress import Bar
from ...factory.common.workers.machine import keep_freed_memory
from ..denoise.journal import Journal, opened_journal
from ..recordings.inputs import FIND, Geometries, InputFile, find_items, sequences
from . import SHIPPED_NAME, find_detector
from .counting import CLASS, counts_of, rows_of
from .files import FrameRow, open_overlay, read_rows, write_results, write_rows
from .frames import frames_of
from .moving import Deviation, deviations_of
from .objects import THRESHOLD, DetectedObject, find_objects
from .runtime import DetectorRuntime
from .track_files import Echogram, draw_tracks, object_of, write_image, write_mot, write_tracks
from .tracker import Track, track_echoes

_KEPT = ".detected"
"""Folder below the results: what was found in each input, so that no run does it again."""
_AT_ONCE = 8  # frames in a call of the network


def main(arguments: Sequence[str]) -> int:
    """`simnfnd detect IN... --out DIR`; 1 when some files were skipped."""
    keep_freed_memory()  # every image needs the same planes again
    options = _options(arguments)
    out = Path(options.out).expanduser()
    detector_path = find_detector(options.detector)
    detector = DetectorRuntime(detector_path)
    classes = _classes(options.classes, detector)
    items = find_items([Path(name).expanduser() for name in options.inputs], out)
    geometries = Geometries(options.geometry, options.opening)
    check_writable(out, "--out")
    with opened_journal(out, _command(options, detector_path), verb="detect") as journal:
        if options.again:
            journal.begin_anew()
        job = _Job(out, detector, classes, geometries, journal, options)
        journal.begin(sequences(items), in_time=False)
        job.run(items)
        journal.finish()
        rows = [row for item in items if item in journal for row in read_rows(job.kept(item))]
        write_results(out, rows, (CLASS,) if options.count else detector.facts.classes)
    for line in job.summary(rows):
        print(line)
    return 1 if job.failures else 0


@dataclass
class _Job:
    """A run of the command: how objects are looked for, and what came of it."""

    out: Path
    detector: DetectorRuntime
    classes: tuple[str, ...]
    geometries: Geometries
    journal: Journal
    options: argparse.Namespace
    failures: list[str] = field(default_factory=list)

    def kept(self, item: InputFile) -> Path:
        """The file of what was found in an input."""
        return self.out / _KEPT / f"{item.relative}.json"

    def run(self, items: Sequence[InputFile]) -> None:
        """Look into all inputs that are not finished.  FactoryError when none can be read."""
        finished = sum(item in self.journal for item in items)
        if finished:
            print(f"already looked into: {finished} file(s); --again looks into them, too")
        left = [item for item in items if item not in self.journal]
        images = sum(item.kind == "images" for item in left)
        with Bar(total=images, unit="image", desc="detecting") as bar:
            bar.uncounted = len(left) - images
            for item in left:
                try:
                    if self.options.count:
                        self._count_in(item, bar)
                    else:
                        self._detect_in(item, bar)
                except FactoryError as error:
                    self.failures.append(_named(item, error))
        if self.failures and len(self.failures) == len(items):
            more = f" (and {len(self.failures) - 1} more)" if len(self.failures) > 1 else ""
            raise FactoryError(self.failures[0] + more)
        for line in self.failures:
            print(f"skipped: {line}", file=sys.stderr)

    def _detect_in(self, item: InputFile, bar: Bar) -> None:
        is_image = item.kind == "images"
        bar.uncounted -= not is_image
        rows = []
        path = self.out / "overlay" / item.relative
        drawing = open_overlay(path, is_image=is_image) if self.options.overlay else nullcontext()
        frames = frames_of(item, self.geometries, self.options.topic)
        with drawing as overlay:
            while batch := list(islice(frames, _AT_ONCE)):
                found = find_objects(
                    self.detector,
                    batch,
                    threshold=self.options.threshold,
                    classes=self.classes,
                )
                for frame, objects in zip(batch, found, strict=True):
                    rows.append(FrameRow.of(str(item.relative), is_image, frame, objects))
                    if overlay is not None:
                        texts = [f"{item.class_name} {item.score:.2f}" for item in objects]
                        overlay.add(frame, list(zip(objects, texts, strict=True)))
                    bar.total += not is_image
                    bar.update()
        self._keep(item, rows)

    def _keep(self, item: InputFile, rows: Sequence[FrameRow]) -> None:
        write_rows(self.kept(item), rows)
        self.journal.add(item, {}, self.kept(item))

    def _count_in(self, item: InputFile, bar: Bar) -> None:
        """Track what moves in a recording, and write its files."""
        if item.kind in ("images", "shard"):
            raise FactoryError(
                "--count: needs a recording, a video or a stack (of a dataset DATASET/PLACE/SCENE)"
            )
        bar.uncounted -= 1
        echogram = Echogram()

        def counted() -> Iterator[Deviation]:
            for deviation in deviations_of(frames_of(item, self.geometries, self.options.topic)):
                bar.total += 1
                bar.update()
                echogram.add(deviation)
                yield deviation

        tracks = track_echoes(counted())
        place = self.out / item.relative
        write_mot(place / "mot.txt", tracks)
        write_image(place / "echogram.png", echogram.image(tracks))
        rows = rows_of(str(item.relative), tracks)
        write_tracks(place / "tracks.csv", rows)
        counts = counts_of(rows)
        print(
            f"{item.source}: {len(tracks)} moving object(s): {counts['left']} to the left, "
            f"{counts['right']} to the right, {counts['towards']} towards, {counts['away']} away"
        )
        if self.options.overlay:
            path = self.out / "overlay" / item.relative
            frames = frames_of(item, self.geometries, self.options.topic)
            with open_overlay(path, is_image=False) as overlay:
                draw_tracks(overlay, frames, tracks)
        self._keep(item, _rows_of_tracks(str(item.relative), tracks, echogram.frames))

    def summary(self, rows: Sequence[FrameRow]) -> Iterator[str]:
        """What a run found, line by line."""
        yield from self.geometries.summary()
        counts: dict[str, int] = {}
        for row in rows:
            for item in row.objects:
                counts[item.class_name] = counts.get(item.class_name, 0) + 1
        by_class = ", ".join(f"{counts[name]} {name}" for name in sorted(counts))
        total = sum(counts.values())
        yield f"found: {total} object(s) in {len(rows)} image(s){': ' * bool(counts)}{by_class}"
        if self.detector.facts.calibration is None or self.options.count:
            yield "scores: they are no probabilities"
        yield f"table: {self.out / 'detections.csv'}; COCO: {self.out / 'detections.json'}"


def _rows_of_tracks(
    file: str, tracks: Sequence[Track], frames: Sequence[tuple[int, float | None, int, int]]
) -> list[FrameRow]:
    """Rows of all frames with the echoes of the tracks."""
    objects: dict[int, list[DetectedObject]] = {}
    for track in tracks:
        for point in track.points:
            objects.setdefault(point.frame.number, []).append(object_of(point))
    return [FrameRow(file, False, *frame, objects.get(frame[0], [])) for frame in frames]


def _named(item: InputFile, error: Exception) -> str:
    text = str(error)
    return text if str(item.source) in text else f"{item.source}: {text}"


def _command(options: argparse.Namespace, detector: Path) -> dict[str, object]:
    """All that decides on the results but for the inputs."""
    names = ("threshold", "classes", "topic", "opening", "overlay", "count")
    chosen: dict[str, object] = {name: getattr(options, name) for name in names}
    table = Path(options.geometry).expanduser()
    chosen["geometry"] = sha256_of(table) if table.is_file() else options.geometry
    chosen["detector"] = sha256_of(detector)
    chosen["version"] = __version__
    return chosen


def _classes(text: str, detector: DetectorRuntime) -> tuple[str, ...]:
    """The classes of `--classes A,B`.  Raises FactoryError for one that the detector lacks."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in detector.facts.classes:
            known = ", ".join(detector.facts.classes)
            raise FactoryError(f"--classes {name}: the detector has {known}")
    return names


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options of the command line, checked.  Raises FactoryError for wrong ones."""
    parser = Parser(prog="simnfnd detect")
    add = parser.add_argument
    inputs_help = "image, folder, dataset, video, recording, bag or array to look into"
    add("inputs", nargs="+", metavar="IN", help=inputs_help)
    add("--out", required=True, metavar="DIR", help="folder for the results")
    detector_help = (
        f"a detector.safetensors of `simnfnd evaluate transfer`, or {SHIPPED_NAME} (default)"
    )
    add("--detector", default=SHIPPED_NAME, metavar="FILE", help=detector_help)
    threshold_help = f"least probability of an object, 0 to 1 (default: {THRESHOLD:g})"
    add("--threshold", type=float, default=THRESHOLD, metavar="PART", help=threshold_help)
    add("--classes", default="", metavar="A,B", help="find these classes alone")
    count_help = (
        "count what moves in recordings instead: tracks.csv, mot.txt and echogram.png of each"
    )
    add("--count", action="store_true", help=count_help)
    add("--overlay", action="store_true", help="also draw the boxes: images and videos in overlay/")
    geometry_help = (
        "geometry of images and videos: `find` it in the image (default), `polar`, `none`, or a "
        "CSV table of fans; shards and recordings know theirs"
    )
    add("--geometry", default=FIND, help=geometry_help)
    opening_help = "for --geometry polar: degrees from the first column's edge to the last one's"
    add("--opening", type=float, metavar="DEG", help=opening_help)
    topics_help = "topic of a bag to look into (may be repeated; default: those of sonars)"
    add("--topic", action="append", default=[], metavar="NAME", help=topics_help)
    add("--again", action="store_true", help="look into all files, finished ones too")
    options: argparse.Namespace = parser.parse_args(list(arguments))
    if not 0 <= options.threshold <= 1:
        raise FactoryError(f"--threshold {options.threshold:g}: must lie between 0 and 1")
    return options
