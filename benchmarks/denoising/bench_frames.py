"""Frames of one scene, real beside simulated: temporal noise, grain, grey values, averaging.

Real: the six raw frames of the ARIS SDK (`experiment=aris_raw` is calibrated to them) and the
video of a fixed DIDSON, both read from ../shared/data where they are.  Simulated: recordings of a
platform that moves as examples/platform.csv says, and of one that stands still.

`python -m benchmarks.denoising.bench_frames PICTURE.png` draws the frames of both side by side.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from benchmarks.report import Options, Section, Table
from benchmarks.shared import run_factory
from simnfnd.evaluation.metrics.frames import frame_noise, grain_correlation, ks_distance
from simnfnd.models.recordings import open_recording

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared/data"
ARIS, DIDSON = DATA / "aris-sdk/sample.aris", DATA / "didson/lamprey1.avi"
LAGS = (1, 2, 3, 5)
AVERAGED = (2, 4)
STILL = "time_s\n" + "".join(f"{0.15 * n:.2f}\n" for n in range(6))

Pictures = npt.NDArray[np.uint8]


def measure(options: Options) -> Section:
    """Two tables: the ARIS profile against its recording, and what time does to the grain."""
    locations = options.amount(4, 1)
    moving = (ROOT / "examples/platform.csv").read_text(encoding="utf-8")
    aris = recordings(["experiment=aris_raw"], moving, locations, options)
    rows = [_over_time("aris_raw, moving", aris)]
    rows.append(
        _over_time("aris_raw, still", recordings(["experiment=aris_raw"], STILL, 1, options))
    )
    didson = [
        "experiment=physical", "noise=moving", "sonar=didson_hf", "sonar.image.layout=polar",
        "sonar.range.auto=false", "sonar.range.min_m=2", "sonar.range.max_m=7",
    ]  # fmt: skip
    rows.append(_over_time("didson_hf, moving", recordings(didson, moving, 1, options)))
    rows.append(_over_time("didson_hf, still", recordings(didson, STILL, 1, options)))
    tables, note = [], "Without ../shared/data no real frame was measured."
    if ARIS.is_file():
        note = ""
        real = _frames(ARIS)
        tables.append(_calibration(real, aris))
        rows.insert(0, _over_time("ARIS SDK, real", [real]))
    if DIDSON.is_file():
        rows.insert(1, _over_time("DIDSON, fixed, real", [_frames(DIDSON)[:60]]))
    columns = ("frames", *(f"lag {lag}" for lag in LAGS), *(f"mean of {n}, dB" for n in AVERAGED))
    about = (
        "Correlation of the grain (what is finer than 15 ranges and 5 beams) against the lag in "
        "frames, and by how much the mean of some frames is nearer than one frame to the mean of "
        "those that begin after them."
    )
    tables.append(Table(columns, tuple(rows), "Grain over time", about))
    return Section(tuple(tables), note)


def recordings(words: list[str], movement: str, locations: int, options: Options) -> list[Pictures]:
    """Noisy frames of simulated recordings, (frames, rows, columns) for each place."""
    quick = ["scenes.width=240", "scenes.height=160"] if options.quick else []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "path.csv")
        path.write_text(movement, encoding="utf-8")
        run_factory(
            [
                *words, "render=embree", "scheduler=serial", f"scenes.path={path}",
                "scenes.width=484", "scenes.height=304", f"scenes.locations={locations}", *quick,
                f"dataset.dir={folder}/made", f"cache.dir={folder}/cache",
            ]
        )  # fmt: skip
        found: dict[bytes, list[Pictures]] = {}
        for shard in sorted(Path(folder, "made").glob("*/*.h5")):
            with h5py.File(shard) as file:
                for scene, picture in zip(file["meta"]["scene"], file["noisy"][:], strict=True):
                    found.setdefault(scene, []).append(picture)
    return [np.stack(frames) for frames in found.values()]


def _frames(path: Path) -> Pictures:
    def each() -> Iterator[Pictures]:
        with open_recording(path) as recording:
            for frame in recording:
                samples = frame.samples
                yield samples if samples.ndim == 2 else samples[..., 0]

    return np.stack(list(each()))


def _calibration(real: Pictures, made: list[Pictures]) -> Table:
    """Real frames against all simulated ones."""
    goal, found = frame_noise(real), [frame_noise(frames) for frames in made]
    rows: list[tuple[str | float, ...]] = []
    for name, label in (
        ("std", "temporal std, grey values"),
        ("constancy", "largest difference of a level from it"),
        ("range_half_width", "correlation half-width, samples"),
        ("beam_half_width", "correlation half-width, beams"),
        ("skewness", "skewness"),
        ("kurtosis", "excess kurtosis"),
        ("static_share", "grain that neighbouring frames share"),
    ):
        values = [float(getattr(one, name)) for one in found]
        wanted = float(getattr(goal, name))
        mean = float(np.mean(values))
        rows.append((label, wanted, mean, f"{min(values):.3g} .. {max(values):.3g}", mean / wanted))
    ks = [ks_distance(real, frames) for frames in made]
    span = f"{min(ks):.3g} .. {max(ks):.3g}"
    rows.append(("KS of the grey values", 0.0, float(np.mean(ks)), span, ""))
    steps = _change_ks(real, made)
    rows.append(("KS of the changes from frame to frame", 0.0, steps, "", ""))
    columns = ("ARIS 1200, 48 x 2000", "sample.aris", "aris_raw", "places", "times")
    return Table(columns, tuple(rows), "Calibration")


def _change_ks(real: Pictures, made: list[Pictures]) -> float:
    """KS distance of the differences of frames that follow each other."""
    shares = []
    for group in ([real], made):
        change = np.concatenate([np.diff(f.astype(np.int16), axis=0).ravel() for f in group])
        shares.append(np.bincount(change + 255, minlength=511).cumsum() / change.size)
    return float(np.abs(shares[0] - shares[1]).max())


def _over_time(label: str, groups: list[Pictures]) -> tuple[str | float, ...]:
    alike = [np.mean([grain_correlation(g, lag) for g in groups]) for lag in LAGS]
    gains = [np.mean([averaging_gain_db(g, n) for g in groups]) for n in AVERAGED]
    return (label, *(float(value) for value in [*alike, *gains]))


def averaging_gain_db(frames: Pictures, count: int) -> float:
    """How much nearer the mean of `count` frames is than one to the mean of two that follow."""
    grey = frames.astype(np.float64)
    one, many = [], []
    for first in range(0, len(grey) - count - 1, count):
        truth = grey[first + count : first + count + 2].mean(axis=0)
        one.append(((grey[first + count - 1] - truth) ** 2).mean())
        many.append(((grey[first : first + count].mean(axis=0) - truth) ** 2).mean())
    return float(10 * np.log10(np.mean(one) / np.mean(many)))


def side_by_side(path: Path) -> None:
    """A picture: a frame of the recording, frames of the profile, and what they have in common."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    real = _frames(ARIS)
    movement = (ROOT / "examples/platform.csv").read_text(encoding="utf-8")
    made = recordings(["experiment=aris_raw"], movement, 4, Options())
    shown = {"ARIS 1200, real (sample.aris)": real, "aris_raw, place 1": made[0]}
    shown |= {f"aris_raw, place {n + 1}": made[n] for n in (1, 3)}
    figure, axes = plt.subplots(1, 6, figsize=(14, 6), width_ratios=[1, 1, 1, 1, 1.4, 1.4])
    for axis, (title, frames) in zip(axes, shown.items(), strict=False):
        axis.imshow(
            frames[0], cmap="gray", vmin=0, vmax=200, aspect="auto", origin="lower",
            extent=(1, 48, 3.3, 23.4), interpolation="nearest",
        )  # fmt: skip
        axis.set_title(title, fontsize=8)
        axis.set_xlabel("beam")
    axes[0].set_ylabel("range, m")
    groups = {"real": [real], "aris_raw": made}
    for label, group in groups.items():
        grey = np.concatenate([frames.ravel() for frames in group])
        axes[4].hist(grey, bins=128, range=(0, 256), density=True, histtype="step", label=label)
        change = np.concatenate([np.diff(f.astype(float), axis=0).ravel() for f in group])
        axes[5].hist(change, bins=121, range=(-60, 60), density=True, histtype="step", label=label)
    axes[4].set_title("grey values", fontsize=8)
    axes[5].set_title("change from frame to frame", fontsize=8)
    for axis in axes[4:]:
        axis.set_yticks([])
        axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    side_by_side(Path(sys.argv[1]))
