"""The report on real images: real.json, real.md and real.html."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...factory.common.files import check_writable
from ...factory.common.workers.tasks import TaskPool
from ..judging.methods import shown
from ..judging.recorded import frame_of, open_input
from ..judging.runner import SECONDS
from ..judging.settings import RealSettings
from ..report.document import ComparedImages, Section, write_report
from ..report.tables import Metric, as_markdown, as_table, interval, written
from .groups import MOST, MOST_OTHERS
from .in_time import wide
from .judge import MARGINS, RealOutcome, ReportRow, judge

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {
    "psnr_db": Metric("PSNR, dB", 2, 1),
    "ssim": Metric("SSIM", 3, 1),
    "gain_db": Metric("gain, dB", 2, 1),
    "margin_db": Metric("ahead of the best filter, dB", 2, 1),
    "margin_ssim": Metric("ahead of it, SSIM", 3, 1),
    "enl": Metric("ENL", 2, 0),
    "cnr": Metric("CNR dark ground", 3, 1),
    "edges_kept": Metric("edges kept", 3, 0),
    "ratio_mean": Metric("ratio mean", 3, 0),
    "ratio_variance": Metric("ratio variance", 3, 0),
    "ratio_correlation": Metric("ratio correlation", 3, 0),
    SECONDS: Metric("CPU s an image", 3, -1),
}
_SIGNED = {"gain_db", *MARGINS.values()}
_WITH_INTERVAL = {"psnr_db", "ssim", *MARGINS.values()}

TRUTH = (
    f"The truth of a frame is the mean of the other frames of its group (of the {MOST_OTHERS} "
    "nearest in time). PSNR and SSIM: inside the sector, without its rim and moving objects, after "
    "one gain and offset an image; means over groups, with 95 % bootstrap intervals that draw "
    "groups. Filters are tuned on every other group and judged on the others. CPU s: the median."
)
IN_TIME = (
    "A method may use the three frames before and after each; the reference is the mean of frames "
    "further away. static: the frames as they are; moving: a window that travels by whole pixels; "
    "ghost: over them a bright speckled object, judged where it is. Means over recordings, with 95 "
    "% bootstrap intervals that draw recordings. Registered: shifted by whole pixels to the peak "
    "of the phase correlation."
)
RULE = (
    "None of the figures without a truth ranks methods alone: blur raises ENL and CNR, and doing "
    "nothing keeps all edges. Ratio image: recorded / denoised, which should be noise alone: mean "
    "1, and no correlation 4 pixels apart, where structure was taken along."
)


def evaluate(settings: RealSettings) -> None:
    """Measure, print the table and write the report.  Raises FactoryError."""
    stretches, notes = open_input(settings.real, MOST)
    check_writable(settings.folder, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(settings, stretches, pool)
    frame_of.cache_clear()
    print(write(settings, [*notes, *outcome.notes], outcome))
    print(f"report: {settings.folder / 'real.html'}")


def write(settings: RealSettings, notes: Sequence[str], outcome: RealOutcome) -> str:
    """Write the three files; returns what the terminal shows: the notes, tables and verdict.

    FactoryError when the folder cannot be written to.
    """
    warnings = [note for note in notes if note.startswith("warning: ")]
    others = [note for note in notes if note not in warnings]
    judged = f"{len(outcome.files)} images judged"
    about = " ".join(f"{'; '.join(lines)}." for lines in (warnings, [judged, *others]) if lines)
    rules = (TRUTH, RULE) if outcome.groups else (RULE,)
    table = table_of(outcome.rows)
    verdict = _verdict(outcome)
    title = "Figures" if outcome.groups else "Figures without a truth"
    sections = [Section(title, [table], [verdict])]
    texts = [about, as_markdown(table), verdict]
    if not outcome.in_time.empty:
        in_time = wide(outcome.in_time, resamples=settings.bootstrap, seed=settings.seed)
        sections.append(Section("In time", [in_time], [IN_TIME]))
        texts += ["In time:", as_markdown(in_time)]
    facts = {
        "schema": "simnfnd-real/2",
        "name": settings.name,
        "files": outcome.files,
        "groups": [
            {
                "name": group.name,
                "frames": [shot.name for shot in group.shots],
                "judged": [group.shots[place].name for place in part.judged],
                "fold": part.fold,
                "largest_shift_px": group.largest_px,
                "judged_share_of_sector": group.still,
                "geometry": "unknown" if group.geometry is None else group.geometry.layout,
            }
            for group, part in zip(outcome.groups, outcome.parts, strict=True)
        ],
        "best_filter": outcome.best,
        "in_time": outcome.in_time.to_dict(orient="records"),
        "notes": notes,
        "rows": outcome.rows,
        "rules": rules,
    }
    write_report(
        settings.folder,
        "real",
        f"Real sonar: {settings.name}",
        about,
        [*sections, Section("How to read them", text=rules)],
        facts=facts,
        examples=_examples(outcome),
    )
    return "\n\n".join(filter(None, texts))


def table_of(rows: Sequence[ReportRow]) -> pd.DataFrame:
    """The means as text, a line a method."""
    names = [name for name in COLUMNS if any(row["means"].get(name) is not None for row in rows)]
    lines = []
    for row in rows:
        cells = [_cell(row, name) for name in names]
        if row["lost"] is not None:
            cells = [f"lost: {row['lost']}", *[""] * len(names[1:])]
        lines.append([_words(row), *cells])
    return as_table(["method", *(COLUMNS[name].label for name in names)], lines)


def _words(row: ReportRow) -> str:
    """The label, and the parameters of each fold."""
    chosen = dict.fromkeys(
        shown(parameters).strip(" ()") for parameters in row["parameters"] if parameters
    )
    return str(row["label"]) + (f" ({' | '.join(chosen)})" if chosen else "")


def _cell(row: ReportRow, name: str) -> str:
    """A figure as text, with its interval where it has one."""
    digits = COLUMNS[name].digits
    signed = name in _SIGNED
    text = written(row["means"].get(name), digits, signed)
    if name in _WITH_INTERVAL and name in row["intervals"]:
        low, high = row["intervals"][name]
        text += f" ({interval({'low': low, 'high': high}, digits, signed)})"
    return text


def _verdict(outcome: RealOutcome) -> str:
    """Which filters are the best."""
    best = dict.fromkeys(f"`{label}`" for label in outcome.best.values())
    return f"The best filter (PSNR, SSIM): {', '.join(best)}." if best else ""


def _examples(outcome: RealOutcome) -> list[ComparedImages]:
    """What the rows made of some images."""
    truth = "mean of the other frames"
    measured = outcome.measured
    examples = []
    for number, judged in sorted(outcome.examples.items()):
        name = judged.shot.name
        if judged.group is not None:
            name = f"{outcome.groups[judged.group].name}: {name}"
        alive = [label for label in measured.figures if label not in measured.lost]
        known = [label for label in alive if (label, number) in measured.images]
        images = {label: measured.images[label, number] for label in known}
        if judged.reference is None:
            examples.append(ComparedImages(name, images))
            continue
        psnr = {label: measured.figures[label][number]["psnr_db"] for label in known}
        examples.append(ComparedImages(name, {**images, truth: judged.reference}, psnr, truth))
    return examples
