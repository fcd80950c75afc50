"""Recordings of scenes that stand still, judged in time: the rows of several frames.

What `in_time` makes of a recording is denoised by each network as `simnfnd denoise` does it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ..methods.method import Method
from ..methods.networks import network
from .groups import Group, nearest
from .in_time import LEAST_FRAMES, ROWS, Gray, kinds_of, rows_of, tuned_weight
from .settings import RealSettings

if TYPE_CHECKING:
    import pandas as pd

_OF_NETWORK = ("one frame", "fused and denoised")
"""Of `in_time.ROWS`, those that the network makes; the others are there once."""
_LIMIT_S = 3600.0  # for a recording and a network


@dataclass(frozen=True)
class TimeRow:
    """A row on one kind of input of one recording: means over the judged frames."""

    recording: str
    kind: str
    row: str
    frames: int
    psnr_db: float
    ssim: float


@dataclass(frozen=True, eq=False)
class InTime:
    """What was judged in time.  notes: what was tuned on what, and what was left out."""

    rows: tuple[TimeRow, ...] = ()
    notes: tuple[str, ...] = ()

    def facts(self) -> list[dict[str, Any]]:
        """For real.json."""
        return [asdict(row) for row in self.rows]

    def table(self) -> pd.DataFrame:
        """A row a method, and of each kind of input the mean PSNR and SSIM over recordings."""
        import pandas as pd

        table = pd.DataFrame(self.facts())
        means = table.groupby(["row", "kind"], sort=False)[["psnr_db", "ssim"]].mean()
        text = means["psnr_db"].map("{:.2f}".format) + " / " + means["ssim"].map("{:.3f}".format)
        kinds = list(dict.fromkeys(table["kind"]))
        wide = text.unstack("kind").loc[list(dict.fromkeys(table["row"])), kinds]
        wide.columns = [f"{kind}, dB / SSIM" for kind in kinds]
        return wide.rename_axis("row").reset_index()


@dataclass(frozen=True, eq=False)
class _Task:
    number: int
    group: Group
    others: tuple[Group, ...]
    weights: str
    label: str
    device: str
    most: int


def judged_in_time(
    settings: RealSettings, groups: Sequence[Group], networks: Sequence[Method], pool: TaskPool
) -> InTime:
    """The rows of every recording that stands still, by each network; nothing without either."""
    recordings = [group for group in groups if _is_recording(group)]
    if not (recordings and networks and settings.in_time):
        return InTime()
    waiting = deque(
        _Task(
            number,
            group,
            tuple(one for one in recordings if one is not group),
            method.weights or "",
            method.label,
            settings.device,
            settings.in_time,
        )
        for number, group in enumerate(recordings)
        for method in networks
    )
    found: dict[tuple[int, str, str], TimeRow] = {}
    notes: dict[str, None] = {}
    with progress_bar(total=len(waiting), unit="recording", desc="in time") as bar:
        for task, result in pool.run(_judged, waiting, lambda _: _LIMIT_S):
            bar.update()
            if isinstance(result, TaskLost):
                notes[f"{task.group.name}, {task.label}: not judged in time ({result.reason})"] = (
                    None
                )
                continue
            rows, note = result
            notes[note] = None
            for row in rows:
                found.setdefault((task.number, row.kind, row.row), row)
    return InTime(tuple(found.values()), tuple(notes))


def _judged(task: _Task) -> tuple[list[TimeRow], str]:
    frames = _frames(task.group, task.most)
    others = [next(kinds_of(_frames(one, task.most))) for one in task.others]
    tuned_on = ", ".join(one.name for one in task.others)
    if not others:
        # Of a single recording the half that comes first, and the whole is judged: said so.
        half = frames[: max(len(frames) // 2, LEAST_FRAMES)]
        others, tuned_on = [next(kinds_of(half))], f"the first {len(half)} frames of itself"
    weight = tuned_weight(others)
    rows = []
    for kind in kinds_of(frames):
        for name, make in rows_of(
            kind, network(task.weights, task.device).denoiser, weight
        ).items():
            scores = [kind.score(number, make(number)) for number in kind.numbers()]
            label = f"{task.label}: {name}" if name in _OF_NETWORK else name
            psnr, ssim = (float(np.mean([one[key] for one in scores])) for key in _FIGURES)
            rows.append(TimeRow(task.group.name, kind.name, label, len(scores), psnr, ssim))
    assert {row.row.removeprefix(f"{task.label}: ") for row in rows} == set(ROWS)
    return rows, f"{task.group.name}: tuned TV has weight {weight:g}, tuned on {tuned_on}"


_FIGURES = ("psnr_db", "ssim")


def _is_recording(group: Group) -> bool:
    """Whether its frames follow each other in one file, and are enough."""
    one_file = len({shot.path for shot in group.shots}) == 1
    return one_file and len(group.shots) >= LEAST_FRAMES


def _frames(group: Group, most: int) -> Gray:
    """(N, H, W) frames of a recording in their order, those in its middle."""
    shots = sorted(group.shots, key=lambda shot: shot.number)
    chosen = nearest(len(shots), len(shots) // 2, max(most, LEAST_FRAMES))
    return np.stack([shots[number].read()[0] for number in chosen])
