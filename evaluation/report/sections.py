"""The parts of report.html below the leaderboard and the viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from simnfnd.evaluation.report.charts import Point, Series, chart
from simnfnd.evaluation.report.content import shown_rows
from simnfnd.evaluation.report.markup import cell, first, head, paragraph, table
from simnfnd.evaluation.report.names import METRIC_NAMES, written
from simnfnd.evaluation.report.robustness import curve_of

Content = Mapping[str, Any]


def cost(content: Content) -> str:
    """PSNR against time, and of networks against multiply-accumulates."""
    rows = {row["label"]: row for row in content["rows"]}
    series = []
    for colour, label in enumerate(shown_rows(content["rows"], 9)):
        row = rows[label]
        if row["kind"] == "noisy" or not row["milliseconds"]:
            continue
        psnr = row["metrics"]["psnr"]
        gmac = f"{row['milliseconds']:.1f} ms"
        gmac += f", {row['gmac']:.2f} GMAC" if row["gmac"] else ""
        point = Point(row["milliseconds"], psnr["mean"], psnr["low"], psnr["high"], f"dB, {gmac}")
        series.append(Series(label, (point,), colour))
    text = chart(
        series,
        x_label="CPU milliseconds an image",
        y_label="PSNR, dB",
        title="PSNR against CPU milliseconds an image",
        lines=False,
        log_x=True,
    )
    networks = [row for row in content["rows"] if row["gmac"] and row["lost"] is None]
    if networks:
        series = []
        labels = shown_rows(content["rows"], 9)
        for row in networks:
            colour = labels.index(row["label"]) if row["label"] in labels else len(labels)
            psnr = row["metrics"]["psnr"]
            point = Point(row["gmac"], psnr["mean"], psnr["low"], psnr["high"], "dB")
            series.append(Series(row["label"], (point,), colour))
        text += chart(
            series,
            x_label="GMAC for 256x256 pixels",
            y_label="PSNR, dB",
            title="PSNR of the networks against multiply-accumulates",
            lines=False,
            log_x=True,
        )
    return text


def paper(content: Content) -> str:
    """Tables 2 and 3, and where the order differs."""
    parts = ["<h3>Table 2</h3>", _beside(content["table_2"])]
    parts.append(_list(content["ordering"]))
    parts += ["<h3>Table 3</h3>", _beside(content["table_3"])]
    if content["ordering_3"]:
        parts.append(_list(content["ordering_3"]))
    else:
        parts.append(paragraph("No weights were given for Table 3 (ablation.* in the settings)."))
    return "".join(parts)


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _beside(printed: Sequence[Content]) -> str:
    digits = {"psnr": 2, "ssim": 3, "gmsd": 3}
    heads = "".join(f"<th>{METRIC_NAMES[m].label} paper</th><th>ours</th>" for m in digits)
    lines = []
    for line in printed:
        cells = [f"<td>{escape(line['title'])}</td>"]
        for metric, places in digits.items():
            ours = None if line["ours"] is None else line["ours"][metric]
            cells.append(f"<td>{written(line['paper'][metric], places)}</td>")
            cells.append(f"<td><b>{written(ours, places)}</b></td>")
        cells.append(f'<td class="left">{escape(line["row"] or "not given")}</td>')
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return table(f'<th>row</th>{heads}<th class="left">row here</th>', lines)


def breakdown(entries: Sequence[Content]) -> str:
    """A table a factor, and curves of the gain where it is a number."""
    parts = [
        '<p class="soft">Mean PSNR in dB of the pairs in each bin; curves: mean paired gain over '
        "the noisy images with its 95 % interval.</p>"
        if entries
        else ""
    ]
    for number, entry in enumerate(entries):
        name, bins = escape(entry["factor"]), entry["bins"]
        heads = "<th>PSNR, dB</th>" + "".join(
            f"<th>{escape(one['label'])}<br>{one['pairs']} pairs</th>" for one in bins
        )
        lines = [
            f"<tr><td>{escape(label)}</td>"
            + "".join(f"<td>{written(one['mean'], 2)}</td>" for one in values)
            + "</tr>"
            for label, values in entry["rows"].items()
        ]
        text = _curves(entry) + table(heads, lines)
        parts.append(
            f"<details><summary>{name}</summary>{text}</details>"
            if number
            else f"<h3>{name}</h3>{text}"
        )
    return "".join(parts)


def _curves(entry: Content) -> str:
    """The gain against the middle of the bins, of all rows but the noisy one."""
    centres = [one["centre"] for one in entry["bins"]]
    if sum(centre is not None for centre in centres) < 2:
        return ""
    series = []
    for colour, (label, values) in enumerate(entry["rows"].items()):
        gains = [one["gain"] for one in values]
        points = tuple(
            Point(centre, gain["mean"], gain["low"], gain["high"])
            for centre, gain in zip(centres, gains, strict=True)
            if centre is not None and gain is not None and gain["mean"] is not None
        )
        if points:
            series.append(Series(label, points, colour))
    unit = f", {entry['unit']}" if entry["unit"] else ""
    return chart(
        series,
        x_label=f"{entry['factor']}{unit}",
        y_label="gain over noisy, dB",
        title=f"gain in PSNR against {entry['factor']}",
        lines=True,
    )


def robustness(content: Content) -> str:
    """The further datasets."""
    entries = content["robustness"]
    if not entries:
        return ""
    labels = [label for label in entries[0]["rows"] if not entries[0]["rows"][label]["lost"]]
    parts = []
    curve = curve_of(entries, content["config"])
    if curve is not None:
        key, values = curve
        rows = {row["label"]: row for row in content["rows"]}
        series = []
        for colour, label in enumerate(labels):
            own = rows[label]["metrics"]["psnr"]
            points = [Point(float(content["config"][key]), own["mean"], own["low"], own["high"])]
            for value, entry in zip(values, entries, strict=True):
                one = entry["rows"][label].get("psnr")
                if one is not None:
                    points.append(Point(value, one["mean"], one["low"], one["high"]))
            series.append(Series(label, tuple(sorted(points, key=lambda p: p.x)), colour))
        parts.append(
            chart(series, x_label=key, y_label="PSNR, dB", title=f"PSNR against {key}", lines=True)
        )
    heads = "<th>PSNR, dB (against noisy)</th>"
    for entry in entries:
        how = ", ".join(f"{key} = {value}" for key, value in entry["differs"].items())
        heads += f"<th>{escape(entry['dataset'])}<br><small>{escape(how[:80])}</small></th>"
    lines = []
    for label in labels:
        cells = [f"<td>{escape(label)}</td>"]
        for entry in entries:
            one = entry["rows"][label]
            text = "lost"
            if not one["lost"]:
                text = written(one["psnr"]["mean"], 2)
                if label != "noisy":
                    text += f" ({written(one['gain']['mean'], 2, True)})"
            cells.append(f"<td>{text}</td>")
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return "".join([*parts, table(heads, lines)])


def more(rows: Sequence[Content]) -> str:
    """Every metric of every row."""
    alive = [row for row in rows if row["lost"] is None]
    names = [n for n in METRIC_NAMES if any(row["metrics"].get(n, {}).get("count") for row in rows)]
    heads = head("method", "ascending", left=True)
    heads += "".join(head(METRIC_NAMES[name].label, first(name)) for name in names)
    lines = [
        f'<tr class="{row["kind"]}"><td>{escape(row["label"])}</td>'
        + "".join(
            cell(
                row["metrics"][n]["mean"],
                written(row["metrics"][n]["mean"], METRIC_NAMES[n].digits),
            )
            for n in names
        )
        + "</tr>"
        for row in alive
    ]
    return table(heads, lines, "board sortable") + paragraph(
        "ENL rewards blur, a ratio mean of 1 is best, and doing nothing has a low M-index: these "
        "three say something beside the others only."
    )
