"""The charts of report.html: quality against cost, gain by factor, PSNR on other noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from .charts import Point, Series, chart
from .content import shown_rows
from .robustness import curve_of

Content = Mapping[str, Any]


def cost(content: Content) -> Markup:
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
    if len(series) < 2:
        return Markup("")  # one point shows no trade
    networks = [row for row in content["rows"] if row["gmac"] and row["lost"] is None]
    if len(networks) > 1:
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


def gain(entry: Content) -> Markup:
    """The gain against the middle of the bins of a factor; empty where it is no number."""
    centres = [one["centre"] for one in entry["bins"]]
    if sum(centre is not None for centre in centres) < 2:
        return Markup("")
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


def robustness(content: Content) -> Markup:
    """PSNR on the further datasets; empty where they do not differ in one number."""
    entries = content["robustness"]
    curve = curve_of(entries, content["config"])
    if curve is None:
        return Markup("")
    key, values = curve
    labels = [label for label in entries[0]["rows"] if not entries[0]["rows"][label]["lost"]]
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
    return chart(series, x_label=key, y_label="PSNR, dB", title=f"PSNR against {key}", lines=True)
