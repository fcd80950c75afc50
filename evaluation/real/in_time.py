"""Recordings of a static scene, judged in time: as they are, moving, with a ghost.

A denoiser may use the frames up to `AWAY` before and after each; the reference is the mean of
frames further away, whose noise it has not seen.  Three kinds of input are made of the same real
frames, none of them interpolated, so that the noise stays the sonar's own:

static  the frames as they are;
moving  a window that travels over them by whole pixels, as if the sonar moved;
ghost   the frames as they are, and over them a bright speckled thing that swims.  It must stay
        where it is, as bright and sharp as a single frame shows it, without a trail.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Array, Bools
from ...factory.common.progress import progress_bar
from ...factory.common.workers.tasks import TaskLost, TaskPool
from ...models.denoise.temporal.stream import InTime, Network, SequenceFrame
from ..filters import REGISTRY
from ..filters.windows import mean_around, registered_mean
from ..judging.methods import Method, network
from ..judging.settings import RealSettings
from ..metrics.fidelity import psnr, ssim_map
from ..metrics.measure import Grey, Levels, fit_levels
from ..metrics.statistics import estimate
from .groups import Group, nearest

if TYPE_CHECKING:
    import pandas as pd

AWAY = 3
FAR = 15
"""Frames up to so far from one are a denoiser's; those beyond, up to so far, make the reference."""
LEAST_FRAMES = 12
WEIGHTS = (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06)
"""Weights of the total variation that are tried."""

_OF_NETWORK = ("one frame", "fused and denoised")  # the other rows are there once
_LIMIT_S = 3600.0  # for a recording and a network

_LIT = 8 / 255
_MOVED_SHARE = 0.05  # of the scene, the part that changes most in time, is left out
_WINDOW = 0.6  # of the height and width, in `moving`
_FASTEST = (4.0, 3.0)  # pixels per frame, down and right
_SWIMS = 6.0
_LENGTH = 12.0
_WIDTH = 3.5
_LEVEL = 0.75
_GRAIN = 0.09
_WAKE_PX = 10


@dataclass(frozen=True, eq=False)
class JudgedInput:
    """One kind of input with what it is judged by.

    frames, references: (N, H, W) float32 in 0..1.  masks: (N, H, W), which pixels count.
    levels: whether one gain and offset is fitted before a frame is judged.
    """

    name: str
    frames: Grey
    references: Grey
    masks: Bools
    levels: bool = True

    def numbers(self, step: int = 1) -> range:
        """The frames that are judged: they have a whole window."""
        return range(AWAY + 1, len(self.frames) - AWAY - 1, step)

    def score(self, number: int, image: Grey) -> dict[str, float]:
        """PSNR (dB) and SSIM of a frame that was made, where its mask is."""
        mask = self.masks[number]
        truth = self.references[number]
        levels = fit_levels([(image[mask], truth[mask])]) if self.levels else Levels(1, 0)
        image = levels(image)
        return {
            "psnr_db": psnr(truth, image, data_range=1, mask=mask),
            "ssim": float(ssim_map(truth, image, data_range=1)[mask].mean()),
        }


def kinds_of(frames: Grey, seed: int = 0) -> Iterator[JudgedInput]:
    """The three kinds of one recording.

    frames: (N, H, W) float32 in 0..1, of a static scene; `LEAST_FRAMES` at least.
    """
    references, masks = _references(frames)
    static = JudgedInput("static", frames, references, masks)
    yield static
    yield _moving(static, np.random.default_rng([seed, 1]))
    yield _ghost(static, np.random.default_rng([seed, 2]))


def rows_of(
    judged: JudgedInput, network: Network, weight: float
) -> dict[str, Callable[[int], Grey]]:
    """Row -> what it makes of a frame.  weight: of the total variation."""
    fused, denoised = (_in_time(judged.frames, model) for model in (None, network))
    tv = REGISTRY["tv"]

    def mean(number: int) -> Grey:
        return mean_around(judged.frames, number, AWAY)

    def registered(number: int) -> Grey:
        return registered_mean(judged.frames, number, AWAY)

    return {
        "one frame": lambda number: network(judged.frames[number], None),
        "fused": lambda number: fused[number],
        "fused and denoised": lambda number: denoised[number],
        "mean of 7": mean,
        "mean of 7 + tuned TV": lambda number: tv(mean(number), {"weight": weight}),
        "registered mean of 7 + tuned TV": lambda number: tv(
            registered(number), {"weight": weight}
        ),
    }


def tuned_weight(others: Sequence[JudgedInput], step: int = 8) -> float:
    """The weight of total variation that is best for means of 7 of other recordings."""
    tv = REGISTRY["tv"]
    means = [
        (judged, number, mean_around(judged.frames, number, AWAY))
        for judged in others
        for number in judged.numbers(step)
    ]

    def gain(weight: float) -> float:
        scores = [
            judged.score(number, tv(mean, {"weight": weight})) for judged, number, mean in means
        ]
        return float(np.mean([each["psnr_db"] for each in scores]))

    return max(WEIGHTS, key=gain)


def _in_time(frames: Grey, network: Network | None) -> list[Grey]:
    """Fused, and denoised where there is a network."""
    shots = (SequenceFrame(number, frame) for number, frame in enumerate(frames))
    return [image for _, image in InTime(network)(shots)]


def _references(frames: Grey) -> tuple[Grey, Bools]:
    """For each frame the mean of those far away, and where the scene is lit and static."""
    count = len(frames)
    lit = cv2.GaussianBlur(frames.mean(axis=0), (0, 0), 2) > _LIT
    references = np.empty_like(frames)
    masks = np.empty(frames.shape, bool)
    for number in range(count):
        apart = np.abs(np.arange(count) - number)
        references[number] = frames[(apart > AWAY) & (apart <= FAR)].mean(axis=0)
        change = np.abs(
            cv2.GaussianBlur(frames[apart <= AWAY].mean(axis=0), (0, 0), 2)
            - cv2.GaussianBlur(references[number], (0, 0), 2)
        )
        limit = np.quantile(change[lit], 1 - _MOVED_SHARE) if lit.any() else 0
        masks[number] = lit & (change < limit)
    return references, masks


def _moving(static: JudgedInput, rng: np.random.Generator) -> JudgedInput:
    """A window of part of the frame on a smooth random way, whole pixels per frame."""
    count, *sides = static.frames.shape
    size = np.array([int(side * _WINDOW) // 8 * 8 for side in sides])
    room = np.array(sides) - size
    fastest = np.array(_FASTEST)
    place = room / 2
    speed = rng.uniform(-1, 1, 2) * fastest
    windows = []
    for _ in range(count):
        top, left = np.rint(place).astype(int)
        windows.append((slice(top, top + size[0]), slice(left, left + size[1])))
        speed = np.clip(speed + rng.normal(0, 0.5, 2), -fastest, fastest)
        speed = np.where((place + speed < 0) | (place + speed > room), -speed, speed)
        place = np.clip(place + speed, 0, room)

    def cut(planes: Array) -> Array:
        return np.stack([plane[window] for plane, window in zip(planes, windows, strict=True)])

    return JudgedInput("moving", cut(static.frames), cut(static.references), cut(static.masks))


def _ghost(static: JudgedInput, rng: np.random.Generator) -> JudgedInput:
    """A bright body with a grain of its own, weaving down the middle of the frame."""
    _, height, width = static.frames.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    frames = static.frames.copy()
    references = static.references.copy()
    masks = np.zeros_like(static.masks)
    wake = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _WAKE_PX + 1,) * 2)
    for number in range(len(frames)):
        swum = _SWIMS * number
        right = x - (0.5 + 0.12 * np.sin(swum / (0.12 * width))) * width
        down = y - (0.35 * height + (0.8 * swum) % (0.4 * height))
        along = 0.34 * right + 0.94 * down
        across = 0.94 * right - 0.34 * down
        body = np.exp(-(((along / _LENGTH) ** 2 + (across / _WIDTH) ** 2) ** 2)).astype(np.float32)
        grain = cv2.GaussianBlur(rng.normal(0, 1, (height, width)).astype(np.float32), (0, 0), 0.7)
        body_grain = _LEVEL + _GRAIN * grain / grain.std()
        frames[number] = np.clip(frames[number] * (1 - body) + body_grain * body, 0, 1)
        references[number] = references[number] * (1 - body) + _LEVEL * body
        masks[number] = cv2.dilate((body > 0.1).astype(np.uint8), wake) > 0
    frames = np.rint(frames * 255) / np.float32(255)
    return JudgedInput("ghost", frames, references, masks, levels=False)


def judged_in_time(
    settings: RealSettings, groups: Sequence[Group], networks: Sequence[Method], pool: TaskPool
) -> tuple[pd.DataFrame, list[str]]:
    """The rows of every static recording, by each network; none without either.

    Returns a line for each recording, kind of input and row: means over the judged frames; and
    notes: what was tuned on what, and what was left out.
    """
    import pandas as pd

    recordings = [group for group in groups if _is_recording(group)] if settings.in_time else []
    waiting = deque(
        (number, recordings, method, settings.device, settings.in_time)
        for number in range(len(recordings))
        for method in networks
    )
    columns = ["number", *_Score._fields]
    if not waiting:
        return pd.DataFrame(columns=columns[1:]), []

    rows = []
    notes = []
    with progress_bar(total=len(waiting), unit="recording", desc="in time") as bar:
        bar.refresh()  # the first recording may take minutes
        for (number, _, method, *_), result in pool.run(_judged, waiting, lambda _: _LIMIT_S):
            bar.update()
            if isinstance(result, TaskLost):
                name = f"{recordings[number].name}, {method.label}"
                notes.append(f"{name}: not judged in time ({result.reason})")
            else:
                rows += [(number, *score) for score in result.scores]
                notes.append(result.note)
    table = pd.DataFrame(rows, columns=columns).drop_duplicates(["number", "kind", "row"])
    return table.drop(columns="number"), list(dict.fromkeys(notes))


def wide(table: pd.DataFrame, *, resamples: int, seed: int) -> pd.DataFrame:
    """A line per row, and of each kind of input the mean PSNR and SSIM over recordings.

    Intervals of the PSNR draw recordings; one alone has none.
    """

    def cell(scores: pd.DataFrame) -> str:
        psnr_db = estimate(
            scores["psnr_db"].to_numpy(float),
            list(scores["recording"]),
            resamples=resamples,
            seed=seed,
        )
        between = f" ({psnr_db.low:.2f} .. {psnr_db.high:.2f})" if psnr_db.count > 1 else ""
        return f"{psnr_db.mean:.2f}{between} / {scores['ssim'].mean():.3f}"

    text = table.groupby(["row", "kind"], sort=False)[["recording", "psnr_db", "ssim"]].apply(cell)
    cells = text.unstack("kind").loc[table["row"].unique(), table["kind"].unique()]
    cells.columns = [f"{kind}, dB / SSIM" for kind in cells.columns]
    return cells.rename_axis("row").reset_index()


class _Score(NamedTuple):
    """Means over the frames of a recording of a row; the names of its fields are columns."""

    recording: str
    kind: str
    row: str
    frames: int
    psnr_db: float
    ssim: float


class _Judgement(NamedTuple):
    """Scores of all rows on a recording, and a line that says what was tuned on what."""

    scores: list[_Score]
    note: str


def _judged(task: tuple[int, list[Group], Method, str, int]) -> _Judgement:
    """Judge a network, and what needs none, on one recording."""
    number, recordings, method, device, most = task
    group = recordings[number]
    frames = _frames(group, most)
    others = [recording for recording in recordings if recording is not group]
    tuning = [next(kinds_of(_frames(recording, most))) for recording in others]
    tuned_on = ", ".join(recording.name for recording in others)
    if not others:
        # A single recording is tuned on its first half and judged as a whole, which a note states.
        half = frames[: max(len(frames) // 2, LEAST_FRAMES)]
        tuning = [next(kinds_of(half))]
        tuned_on = f"the first {len(half)} frames of itself"
    weight = tuned_weight(tuning)
    denoiser = network(method.weights or "", device)
    scores = []
    for kind in kinds_of(frames):
        for name, make in rows_of(kind, denoiser, weight).items():
            frame_scores = [kind.score(number, make(number)) for number in kind.numbers()]
            label = f"{method.label}: {name}" if name in _OF_NETWORK else name
            psnr_db, similarity = (
                float(np.mean([score[key] for score in frame_scores]))
                for key in ("psnr_db", "ssim")
            )
            frame_count = len(frame_scores)
            scores.append(_Score(group.name, kind.name, label, frame_count, psnr_db, similarity))
    return _Judgement(scores, f"{group.name}: tuned TV has weight {weight:g}, tuned on {tuned_on}")


def _is_recording(group: Group) -> bool:
    """Whether its frames follow each other in one file, and are enough."""
    one_file = len({shot.path for shot in group.shots}) == 1
    return one_file and len(group.shots) >= LEAST_FRAMES


def _frames(group: Group, most: int) -> Grey:
    """(N, H, W) frames of a recording in their order, those in its middle."""
    shots = sorted(group.shots, key=lambda shot: shot.number)
    chosen = nearest(len(shots), len(shots) // 2, max(most, LEAST_FRAMES))
    return np.stack([shots[number].read()[0] for number in chosen])
