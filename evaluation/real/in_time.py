"""Recordings of a static scene, judged in time: as they are, moving, with a ghost.

Every second frame is input, and the mean of the frames between is the truth: a denoiser may use as
many input frames as it likes without having seen the noise of the truth.  Three kinds of input are
made of the same real frames, none of them interpolated, so that the noise stays the sonar's own:

static  the frames as they are;
moving  a window that travels over them by whole pixels, as if the sonar moved;
ghost   the frames as they are, and over them a bright speckled body that swims.  It must stay
        where it is, as bright and sharp as a single frame shows it, without a trail.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...factory.common.array_types import Array, Bools, Floats
from ...factory.common.errors import FactoryError
from ...factory.common.progress import Bar
from ...factory.common.workers.tasks import TaskPool
from ...models.denoise.options import FRAMES
from ..filters import Parameters
from ..filters.windows import mean_around
from ..judging.methods import Method, shown
from ..judging.runner import Denoised, Measured, Subject, run
from ..judging.sequences import How, SequenceMethod, denoise_frames
from ..judging.settings import RealSettings
from ..judging.tuning import TuningImage, TuningTask, on_frames
from ..metrics.measure import Figures, Grey, likeness
from ..metrics.statistics import estimate, evenly
from .groups import LEAST, MOST_FRAMES, MOST_OTHERS, Group, nearest

if TYPE_CHECKING:
    import pandas as pd

_WINDOW_SHARE = 0.6  # of the height and width, in `moving`
_WINDOW_PX = 4.0  # longest step of the window from one input frame to the next
_SWIM_PX = 6.0  # longest step of the ghost
_BODY_PX = 6.0  # radius of the ghost, which is as bright as `_LEVEL`
_LEVEL = 0.75


@dataclass(frozen=True, eq=False)
class JudgedInput(Subject):
    """One kind of input with what it is judged by.

    frames, references: (N, H, W) float32 in 0..1.  masks: (N, H, W), which pixels count.
    levels: whether one gain and offset is fitted before a frame is judged.
    fold: number of the recording.
    """

    kind: str
    frames: Grey
    references: Grey
    masks: Bools
    levels: bool = True
    fold: int = 0

    @property
    def images(self) -> int:
        """See `Subject`."""
        return len(self.frames)

    def load(self) -> None:
        """See `Subject`; the frames are there."""

    def denoise(self, method: Method, device: str) -> Denoised:
        """See `Subject`."""
        assert isinstance(method, SequenceMethod)
        return Denoised(denoise_frames(method, self.frames, device, self.fold))

    def measure(self, image: Array) -> Figures:
        """Mean PSNR (dB) and SSIM of the frames (N, H, W), where their masks are."""
        scores = [
            likeness(frame, reference, mask, levels=self.levels)
            for frame, reference, mask in zip(image, self.references, self.masks, strict=True)
        ]
        return {name: float(np.mean([score[name] for score in scores])) for name in scores[0]}


def static_input(frames: Grey, mask: Bools, fold: int = 0) -> JudgedInput:
    """Every second frame of a static scene, and as truth the mean of the frames between.

    frames: (N, H, W) float32 in 0..1.  mask: (H, W) bool, the pixels that count.
    """
    inputs = frames[::2]
    between = frames[1::2]
    references = np.stack([
        between[nearest(len(between), number, MOST_OTHERS)].mean(axis=0)
        for number in range(len(inputs))
    ])  # fmt: skip
    return JudgedInput("static", inputs, references, np.stack([mask] * len(inputs)), fold=fold)


def kinds_of(static: JudgedInput, seed: int = 0) -> Iterator[JudgedInput]:
    """The three kinds of one recording."""
    yield static
    yield _moving(static, np.random.default_rng([seed, 1]))
    yield _ghost(static, np.random.default_rng([seed, 2]))


def _path(room: Floats, longest_px: float, count: int, rng: np.random.Generator) -> Iterator[Array]:
    """Places (2,) of a smooth random way from the middle of a room (2,), whose walls reflect."""
    place = room / 2
    speed = rng.uniform(-1, 1, 2) * longest_px
    for _ in range(count):
        yield place
        speed = np.clip(speed + rng.normal(0, longest_px / 8, 2), -longest_px, longest_px)
        speed = np.where((place + speed < 0) | (place + speed > room), -speed, speed)
        place = np.clip(place + speed, 0, room)


def _moving(static: JudgedInput, rng: np.random.Generator) -> JudgedInput:
    """A window of part of the frame on a smooth random way, whole pixels per frame."""
    count, *sides = static.frames.shape
    size = (np.array(sides) * _WINDOW_SHARE).astype(int)
    windows = []
    for place in _path(np.array(sides) - size, _WINDOW_PX, count, rng):
        top, left = np.rint(place).astype(int)
        windows.append((slice(top, top + size[0]), slice(left, left + size[1])))

    def cut(planes: Array) -> Array:
        return np.stack([plane[window] for plane, window in zip(planes, windows, strict=True)])

    planes = (cut(static.frames), cut(static.references), cut(static.masks))
    return JudgedInput("moving", *planes, fold=static.fold)


def _ghost(static: JudgedInput, rng: np.random.Generator) -> JudgedInput:
    """A bright round body with the relative noise of the recording; judged at it and its wake."""
    count, height, width = static.frames.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    frames = static.frames.copy()
    references = static.references.copy()
    masks = np.zeros_like(static.masks)
    lit = static.masks[0]
    noise = (frames - references)[:, lit].std() / max(references[:, lit].mean(), 1e-6)
    margin_px = 2 * _BODY_PX
    room = np.maximum(np.array([height, width]) - 2 * margin_px, 0)
    for number, (down, right) in enumerate(_path(room, _SWIM_PX, count, rng)):
        distance = np.hypot(y - down - margin_px, x - right - margin_px)
        body = np.exp(-((distance / _BODY_PX) ** 4))
        grain = _LEVEL * (1 + noise * rng.normal(0, 1, (height, width)))
        frames[number] = np.clip(frames[number] * (1 - body) + grain * body, 0, 1)
        references[number] = references[number] * (1 - body) + _LEVEL * body
        masks[number] = distance < margin_px
    frames = np.rint(frames * 255) / np.float32(255)
    return JudgedInput("ghost", frames, references, masks, levels=False, fold=static.fold)


def tuning_images(
    static: JudgedInput, most: int = MOST_FRAMES, reach: int = 0
) -> list[TuningImage]:
    """Evenly spread frames to tune a filter on, or the means of frames within reach of each."""
    return [
        TuningImage(
            mean_around(static.frames, number, reach),
            static.references[number],
            static.masks[number],
        )
        for number in evenly(range(static.images), most)
    ]


class Judgement(NamedTuple):
    """What a report says of recordings in time.

    table: a line for each recording, kind of input and row.  notes: what was tuned on what, and
    which rows are lost.
    """

    table: pd.DataFrame
    notes: list[str]


def judged_in_time(
    settings: RealSettings, groups: Sequence[Group], networks: Sequence[Method], pool: TaskPool
) -> Judgement:
    """The rows of every static recording, by each network; none without either."""
    recordings = [group for group in groups if _is_recording(group)] if settings.in_time else []
    if not recordings or not networks:
        return _judgement([], Measured(), [])
    statics = [
        static_input(_frames(group, settings.in_time), group.mask, number)
        for number, group in enumerate(recordings)
    ]
    parameters = tuple(map(_tuned, statics))
    notes = [
        f"{group.name}: TV of means is tuned on the first half of the frames{shown(point)}"
        for group, point in zip(recordings, parameters, strict=True)
    ]
    methods = _methods_of(networks, parameters)
    subjects = [kind for static in statics for kind in kinds_of(static)]
    with Bar(total=len(methods) * len(subjects), unit="row", desc="in time") as bar:
        bar.refresh()  # the first recording may take minutes
        measured = run(
            methods,
            ({number: subject} for number, subject in enumerate(subjects)),
            pool,
            device=settings.device,
            timeout_s=settings.image_timeout_s,
            tick=bar.update,
        )
    notes += [f"{label}: not judged in time ({reason})" for label, reason in measured.lost.items()]
    names = [(recordings[kind.fold].name, kind.kind, kind.images) for kind in subjects]
    return _judgement(names, measured, notes)


def _judgement(
    names: Sequence[tuple[str, str, int]], measured: Measured, notes: list[str]
) -> Judgement:
    """names: recording, kind and number of frames of each subject."""
    import pandas as pd

    subjects = pd.DataFrame(names, columns=["recording", "kind", "frames"])
    table = measured.table().join(subjects, on="picture").rename(columns={"method": "row"})
    columns = ["recording", "kind", "row", "frames", "psnr", "ssim"]
    return Judgement(table.sort_values("picture", kind="stable").reindex(columns=columns), notes)


def _methods_of(networks: Sequence[Method], tv: tuple[Parameters, ...]) -> list[SequenceMethod]:
    """The rows: of each network, and those that need none."""
    mean = f"mean of {FRAMES}"
    methods = []
    for model in networks:
        rows: dict[str, How] = {"one frame": "single", "fused and denoised": "fusion"}
        for name, how in rows.items():
            label = f"{model.label}: {name}"
            methods.append(
                SequenceMethod(label, "", {}, weights=model.weights, how=how, window=FRAMES)
            )
    return [
        *methods,
        SequenceMethod("fused", "", {}, how="fusion", window=FRAMES),
        SequenceMethod(mean, "", {}, how="mean", window=FRAMES),
        SequenceMethod(
            f"{mean} + tuned TV", "", {}, folds=tv, how="mean", window=FRAMES, after="tv"
        ),
        SequenceMethod(
            f"registered {mean} + tuned TV", "", {}, folds=tv, how="registered mean",
            window=FRAMES, after="tv",
        ),
    ]  # fmt: skip


def _tuned(static: JudgedInput) -> Parameters:
    """Parameters of the total variation of means, tuned on the first half of the input frames."""
    samples = tuning_images(static, static.images, FRAMES // 2)[: static.images // 2]
    tuned = on_frames(TuningTask("tv", tuple(evenly(samples, MOST_FRAMES))))
    if isinstance(tuned, str):
        raise FactoryError(f"total variation cannot be tuned: {tuned}")
    return tuned


def wide(table: pd.DataFrame, *, resamples: int, seed: int) -> pd.DataFrame:
    """A line per row, and of each kind of input the mean PSNR and SSIM over recordings.

    Intervals of the PSNR draw recordings; one alone has none.
    """

    def cell(scores: pd.DataFrame) -> str:
        psnr_db = scores["psnr"].to_numpy(float)
        mean = estimate(psnr_db, list(scores["recording"]), resamples=resamples, seed=seed)
        between = f" ({mean.low:.2f} .. {mean.high:.2f})" if mean.count > 1 else ""
        return f"{mean.mean:.2f}{between} / {scores['ssim'].mean():.3f}"

    text = table.groupby(["row", "kind"], sort=False)[["recording", "psnr", "ssim"]].apply(cell)
    cells = text.unstack("kind").loc[table["row"].unique(), table["kind"].unique()]
    cells.columns = [f"{kind}, dB / SSIM" for kind in cells.columns]
    return cells.rename_axis("row").reset_index()


def _is_recording(group: Group) -> bool:
    """Whether its frames follow each other in one file, and are enough."""
    one_file = len({shot.path for shot in group.shots}) == 1
    return one_file and len(group.shots) >= 2 * LEAST


def _frames(group: Group, most: int) -> Grey:
    """(N, H, W) frames of a recording in their order, those in its middle."""
    shots = sorted(group.shots, key=lambda shot: shot.number)
    chosen = nearest(len(shots), len(shots) // 2, max(most, 2 * LEAST))
    return np.stack([shots[number].read()[0] for number in chosen])
