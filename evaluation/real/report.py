"""The report on real pictures: real.json, real.md and real.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...factory.files import check_writable
from ...factory.scheduler.workers.tasks import TaskPool
from ...models.recordings.fan.pings import close_last
from ..methods import shown
from ..report.page import as_data_uri, as_json, render, write_files
from ..report.tables import Metric, as_markdown, as_table, interval, plain, written
from ..runner import SECONDS
from ..settings import RealSettings
from .groups import MOST_OTHERS
from .in_time import wide
from .judge import MARGINS, TUNED, Outcome, RealRow, judge
from .shots import frame_of, open_input

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
    "shadow_level": Metric("dark / bright", 3, -1),
    "edges_kept": Metric("edges kept", 3, 0),
    "ratio_mean": Metric("ratio mean", 3, 0),
    "m_index": Metric("M-index", 2, 0),
    SECONDS: Metric("CPU s a picture", 3, -1),
}
_SIGNED = {"gain_db", *MARGINS.values()}
_WITH_INTERVAL = {"psnr_db", "ssim", *MARGINS.values()}

TRUTH = (
    f"The truth of a frame is the mean of the other frames of its group (of the {MOST_OTHERS} "
    "nearest in time), registered below a pixel. What changes in time is gone from it; speckle "
    "that stands still is not, so a perfect despeckler is capped. PSNR and SSIM are taken inside "
    "the sector, without its rim and what moves, after one gain and offset a picture. Gain is "
    "against the picture as it is.",
    "Means are over groups, of each group the mean over its frames; brackets hold 95 % bootstrap "
    "intervals that draw groups. Filters are tuned for this PSNR on every other group and judged "
    "on the others, and the other way round; both sets of parameters are shown. The best filter "
    "is the one with the best mean here, of PSNR and of SSIM each. CPU s: the median.",
)
IN_TIME = (
    "A method may use the three frames before and after each; the reference is the mean of frames "
    "further away. static: the frames as they are; moving: a window that travels by whole "
    "pixels; ghost: over them a bright speckled thing, judged where it is. Mean of 7 is that of "
    "the whole window without alignment. Means over recordings."
)
RULES = (
    "Of the figures without a truth none alone says that one method is better than another: blur "
    "alone raises ENL and CNR, and doing nothing keeps all edges and has a low M-index. Read them "
    "together, and look at the pictures.",
    "Even zones are the tenth of all 16x16 blocks of the picture as it is with the least std / "
    "mean; dark ground is the darkest tenth and bright ground the brighter half of the sector by "
    "its 15-pixel median. They are the same for all methods.",
    "Edges kept and ratio mean are against the picture as it is, noise and all: 1 means unchanged.",
)


def evaluate(settings: RealSettings) -> None:
    """Measure, print the table and write the report.  Raises FactoryError."""
    stretches, notes = open_input(settings.real)
    check_writable(settings.folder, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(settings, stretches, pool)
    close_last()
    frame_of.cache_clear()
    print(write(settings.folder, settings.name, [*notes, *outcome.notes], outcome))
    print(f"report: {settings.folder / 'real.html'}")


def write(out: Path, name: str, notes: Sequence[str], outcome: Outcome) -> str:
    """Write the three files; returns what the terminal shows: the notes, table and verdicts.

    FactoryError when the folder cannot be written to.
    """
    lines = [_line(row, outcome) for row in outcome.rows]
    rules = (*TRUTH, *RULES) if outcome.groups else RULES
    about = "; ".join([f"{len(outcome.files)} pictures judged", *notes]) + "."
    in_time = None if outcome.in_time.empty else wide(outcome.in_time)
    verdict, table, by_group = _verdict(lines, outcome), table_of(lines), _by_group(lines, outcome)
    page = render(
        "real.html",
        title=f"Real sonar: {name}",
        about=about,
        verdict=verdict.replace("`", ""),
        truth=bool(outcome.groups),
        table=table,
        by_group=by_group,
        in_time=in_time,
        in_time_rule=IN_TIME,
        rules=rules,
        strips=_strips(outcome),
    )
    said = [about, as_markdown(table), verdict]
    parts = [f"# Real sonar: {name}", *said]
    if outcome.groups:
        parts += ["## PSNR by group, dB", as_markdown(by_group)]
    if in_time is not None:
        parts += ["## In time", as_markdown(in_time), IN_TIME]
    facts = {
        "schema": "simnfnd-real/2",
        "name": name,
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
        "rows": lines,
        "rules": rules,
    }
    markdown = "\n\n".join(filter(None, [*parts, "## How to read them", *rules])) + "\n"
    write_files(out, {"real.json": as_json(facts), "real.md": markdown, "real.html": page})
    return "\n\n".join(filter(None, said))


def table_of(lines: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The means as text, a line a method."""
    names = [name for name in COLUMNS if any(line["means"][name] is not None for line in lines)]
    rows = []
    for line in lines:
        cells = [_cell(line, name) for name in names]
        if line["lost"] is not None:
            cells = [f"lost: {line['lost']}", *[""] * len(names[1:])]
        rows.append([_words(line), *cells])
    return as_table(["method", *(COLUMNS[name].label for name in names)], rows)


def _line(row: RealRow, outcome: Outcome) -> dict[str, Any]:
    """A row as plain data."""
    found = outcome.summaries.get(row.label)
    lost = outcome.measured.lost.get(row.label)
    figures = {} if lost is not None else outcome.measured.figures.get(row.label, {})
    groups = {} if found is None or not outcome.groups else found.groups
    return {
        "label": row.label,
        "network": row.kind == "network",
        "parameters": [method.parameters for method in row.methods],
        "lost": lost,
        "unchanged": None if found is None or row.kind == "noisy" else found.unchanged,
        "measured": 0 if found is None else found.pictures,
        "means": {n: None if found is None else plain(found.means.get(n)) for n in COLUMNS},
        "intervals": {} if found is None else {k: list(v) for k, v in found.intervals.items()},
        "by_group": {
            name: [plain(value) for value in groups[name]]
            for name in ("psnr_db", "ssim", *MARGINS.values())
            if name in groups
        },
        "pictures": [
            {name: plain(value) for name, value in one.items()}
            for _, one in sorted(figures.items())
        ],
    }


def _words(line: Mapping[str, Any]) -> str:
    """The label, the parameters of each fold, and what came back unchanged."""
    chosen = dict.fromkeys(shown(one).strip(" ()") for one in line["parameters"] if one)
    text = str(line["label"]) + (f" ({' | '.join(chosen)})" if chosen else "")
    if line["unchanged"]:
        every = line["unchanged"] == line["measured"]
        how = "" if every else f": {line['unchanged']} of {line['measured']}"
        text += f" (unchanged{how})"
    return text


def _cell(line: Mapping[str, Any], name: str) -> str:
    """A figure as text, with its interval where it has one."""
    digits, signed = COLUMNS[name].digits, name in _SIGNED
    text = written(line["means"][name], digits, signed)
    if name in _WITH_INTERVAL and name in line["intervals"]:
        low, high = line["intervals"][name]
        text += f" ({interval({'low': low, 'high': high}, digits, signed)})"
    return text


def _verdict(lines: Sequence[Mapping[str, Any]], outcome: Outcome) -> str:
    """How far each network is ahead of the best filter, in words."""
    if not outcome.best:
        return ""
    psnr_best, ssim_best = (outcome.best[name] for name in MARGINS)
    which = f"`{psnr_best}`"
    if ssim_best != psnr_best:
        which = f"`{psnr_best}` in PSNR and `{ssim_best}` in SSIM"
    found = [f"The best filter is {which}."]
    for line in lines:
        if line["network"] and line["lost"] is None:
            psnr, ssim = (_cell(line, name) for name in MARGINS.values())
            found.append(f"`{line['label']}` is {psnr} dB and {ssim} SSIM from it.")
    return " ".join(found)


def _by_group(lines: Sequence[Mapping[str, Any]], outcome: Outcome) -> pd.DataFrame:
    """The table of PSNR by group."""
    alive = [line for line in lines if line["lost"] is None and line["by_group"]]
    rows = [
        [
            f"{group.name} ({len(group.shots)} frames)",
            *(written(line["by_group"]["psnr_db"][number], 2) for line in alive),
        ]
        for number, group in enumerate(outcome.groups)
    ]
    return as_table(["group", *(one["label"].removesuffix(f" {TUNED}") for one in alive)], rows)


def _strips(outcome: Outcome) -> list[tuple[str, bool, list[tuple[str, str]]]]:
    """Title, whether it is wide, and (caption, picture) of each picture that is shown."""
    found = []
    for number, judged in sorted(outcome.shown.items()):
        title = judged.shot.name
        if judged.group is not None:
            title = f"{outcome.groups[judged.group].name}: {title}"
        images = []
        for row in outcome.rows:
            image = outcome.measured.images.get((row.label, number))
            if image is not None and row.label not in outcome.measured.lost:
                psnr_db = outcome.measured.figures[row.label][number].get("psnr_db")
                caption = row.label if psnr_db is None else f"{row.label}, {psnr_db:.2f} dB"
                images.append((caption, as_data_uri(image)))
        if judged.reference is not None:
            images.append(("mean of the other frames", as_data_uri(judged.reference)))
        height, width = judged.noisy.shape
        found.append((title, width > 1.2 * height, images))
    return found
