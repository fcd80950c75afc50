"""The report on real pictures: real.json, real.md and real.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...factory.files import check_writable
from ...factory.scheduler.workers.tasks import TaskPool
from ...models.recordings.fan.pings import close_last
from ..methods import shown
from ..report.page import as_data_uri, as_json, own_file, render, write_files
from ..report.tables import Metric, as_markdown, as_table, interval, plain, written
from ..runner import SECONDS
from ..settings import RealSettings
from .groups import LEAST_LEFT, MOST_OTHERS
from .judge import MARGINS, TUNED, Outcome, RealRow, judge
from .shots import open_input

COLUMNS = {
    "psnr_db": Metric("PSNR, dB", 2, 1),
    "ssim": Metric("SSIM", 3, 1),
    "gain_db": Metric("gain, dB", 2, 1),
    "margin_db": Metric("ahead of the best filter, dB", 2, 1),
    "margin_ssim": Metric("ahead of it, SSIM", 3, 1),
    "enl": Metric("ENL", 2, 0),
    "cnr": Metric("CNR dark ground", 3, 1),
    "object_cnr": Metric("CNR objects", 3, 1),
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
    "Several frames: each picture is the mean or median of the frame and its nearest neighbours "
    "in time, laid over it; its reference is the mean of the group's other frames alone, so it "
    "holds none of the averaged ones. These rows therefore have another, noisier reference than "
    "the others (compare their gain, which is against the single frame with that same reference), "
    f"and groups that leave fewer than {LEAST_LEFT} frames for it do not count.",
)
IN_TIME = (
    "A method may use the three frames before and after each; the reference is the mean of frames "
    "further away. still: the frames as they are; moving: a window that travels over them by whole "
    "pixels; swimmer: over them a bright speckled thing, judged where it is. Mean of 7 is that of "
    "the whole window without alignment. Means over recordings."
)
RULES = (
    "Of the figures without a truth none alone says that one method is better than another: blur "
    "alone raises ENL and CNR, and doing nothing keeps all edges and has a low M-index. Read them "
    "together, and look at the pictures.",
    "Even zones are the tenth of all 16x16 blocks of the picture as it is with the least std / "
    "mean; dark ground is the darkest tenth and bright ground the brighter half of the sector by "
    "its 15-pixel median. They are the same for all methods. Objects, where masks tell them, are "
    "compared with the 15 pixels around.",
    "Edges kept and ratio mean are against the picture as it is, noise and all: 1 means unchanged.",
)


def evaluate(settings: RealSettings) -> None:
    """Measure, print the table and write the report.  Raises FactoryError."""
    stretches, notes = open_input(settings.real, settings.search)
    out = settings.folder
    check_writable(out, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(settings, stretches, pool)
    close_last()
    print(write(out, settings.name, [*notes, *outcome.notes], outcome))
    print(f"report: {out / 'real.html'}")


def write(out: Path, name: str, notes: Sequence[str], outcome: Outcome) -> str:
    """Write the three files; returns what the terminal shows: the notes, table and verdicts.

    FactoryError when the folder cannot be written to.
    """
    lines = [_line(row, outcome) for row in outcome.rows]
    rules = (*TRUTH, *RULES) if outcome.groups else RULES
    about = "; ".join([f"{len(outcome.files)} pictures judged", *notes]) + "."
    in_time = outcome.in_time.table() if outcome.in_time.rows else None
    verdicts = _verdicts(lines, outcome)
    names = _names(lines)
    page = render(
        "real.html",
        css=own_file("page.css"),
        title=f"Real sonar: {name}",
        about=about,
        verdicts=[text.replace("`", "") for text in verdicts],
        truth=bool(outcome.groups),
        lines=lines,
        names=names,
        columns=COLUMNS,
        cells={line["label"]: _cells(line, names) for line in lines},
        notes={line["label"]: " ".join(_words(line)[1:]).strip() for line in lines},
        by_group=_by_group(lines, outcome),
        in_time=None if in_time is None else [list(in_time), *in_time.to_numpy().tolist()],
        in_time_rule=IN_TIME,
        rules=rules,
        strips=_strips(outcome),
    )
    said = [about, markdown_table(lines), *verdicts]
    parts = [f"# Real sonar: {name}", *said]
    if outcome.groups:
        parts += ["## PSNR by group, dB", as_markdown(as_table(*_by_group(lines, outcome)))]
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
        "in_time": [asdict(row) for row in outcome.in_time.rows],
        "notes": notes,
        "rows": lines,
        "rules": rules,
    }
    markdown = "\n\n".join([*parts, "## How to read them", *rules, ""])
    write_files(out, {"real.json": as_json(facts), "real.md": markdown, "real.html": page})
    return "\n\n".join(said)


def markdown_table(lines: Sequence[Mapping[str, Any]]) -> str:
    """The means, a line a method."""
    names = _names(lines)
    rows = [
        [
            "".join(_words(line)),
            *(_cells(line, names) or [f"lost: {line['lost']}", *[""] * len(names[1:])]),
        ]
        for line in lines
    ]
    head = ["method", *(COLUMNS[name].label for name in names)]
    return as_markdown(as_table(head, rows))


def _line(row: RealRow, outcome: Outcome) -> dict[str, Any]:
    found = outcome.summaries.get(row.label)
    lost = outcome.measured.lost.get(row.label)
    figures = {} if lost is not None else outcome.measured.figures.get(row.label, {})
    means = {name: None if found is None else plain(found.means.get(name)) for name in COLUMNS}
    groups = {} if found is None or not outcome.groups else found.groups
    return {
        "label": row.label,
        "network": row.kind == "network",
        "parameters": [method.parameters for method in row.methods],
        "lost": lost,
        "unchanged": None if found is None or row.kind == "noisy" else found.unchanged,
        "measured": 0 if found is None else found.pictures,
        "means": means,
        "intervals": {} if found is None else {k: list(v) for k, v in found.intervals.items()},
        "by_group": {
            name: [plain(value) for value in groups[name]]
            for name in ("psnr_db", "ssim", *MARGINS.values())
            if name in groups
        },
        "pictures": [
            {name: plain(value) for name, value in figures[number].items()}
            if number in figures
            else None
            for number in range(len(outcome.files) if lost is None else 0)
        ],
    }


def _words(line: Mapping[str, Any]) -> list[str]:
    """The label, the parameters of each fold, and what came back unchanged."""
    found = [line["label"]]
    chosen = list(dict.fromkeys(shown(one) for one in line["parameters"] if one))
    if chosen:
        found.append(" (" + " | ".join(one.strip(" ()") for one in chosen) + ")")
    if line["unchanged"]:
        every = line["unchanged"] == line["measured"]
        found.append(
            " (unchanged)" if every else f" (unchanged: {line['unchanged']} of {line['measured']})"
        )
    return found


def _cells(line: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """The figures of a row as text; none for a lost one."""
    if line["lost"] is not None:
        return []
    found = []
    for name in names:
        digits, signed = COLUMNS[name].digits, name in _SIGNED
        text = written(line["means"][name], digits, signed)
        if name in _WITH_INTERVAL and name in line["intervals"]:
            low, high = line["intervals"][name]
            text += f" ({interval({'low': low, 'high': high}, digits, signed)})"
        found.append(text)
    return found


def _names(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    return [name for name in COLUMNS if any(line["means"][name] is not None for line in lines)]


def _verdicts(lines: Sequence[Mapping[str, Any]], outcome: Outcome) -> list[str]:
    """How far each network is ahead of the best filter, in words."""
    if not outcome.best:
        return []
    psnr_best, ssim_best = (outcome.best[name] for name in MARGINS)
    which = f"`{psnr_best}`"
    if ssim_best != psnr_best:
        which = f"`{psnr_best}` in PSNR and `{ssim_best}` in SSIM"
    found = [f"The best filter is {which}."]
    for line in lines:
        if line["network"] and line["lost"] is None:
            more = dict(zip(MARGINS, _cells(line, list(MARGINS.values())), strict=True))
            found.append(
                f"`{line['label']}` is {more['psnr_db']} dB and {more['ssim']} SSIM from it."
            )
    return [" ".join(found)]


def _by_group(
    lines: Sequence[Mapping[str, Any]], outcome: Outcome
) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of PSNR by group."""
    told = [line for line in lines if line["lost"] is None and line["by_group"]]
    rows = [
        [
            f"{group.name} ({len(group.shots)} frames)",
            *(written(line["by_group"]["psnr_db"][number], 2) for line in told),
        ]
        for number, group in enumerate(outcome.groups)
    ]
    return ["group", *(line["label"].removesuffix(f" {TUNED}") for line in told)], rows


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
                images.append((_caption(row, number, outcome), as_data_uri(image)))
        if judged.reference is not None:
            images.append(("mean of the other frames", as_data_uri(judged.reference)))
        height, width = judged.noisy.shape
        found.append((title, width > 1.2 * height, images))
    return found


def _caption(row: RealRow, number: int, outcome: Outcome) -> str:
    figures = outcome.measured.figures[row.label].get(number, {})
    text = row.label
    if figures.get("unchanged") and row.kind != "noisy":
        text += ": unchanged"
    if "psnr_db" in figures:
        text += f", {figures['psnr_db']:.2f} dB"
    return text
