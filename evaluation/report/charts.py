"""Charts, by matplotlib: SVG inside a page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from .content import shown_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Content = Mapping[str, Any]


def cost(content: Content) -> Markup:
    """PSNR against time of the best form of each method; empty where one point shows no trade."""
    from matplotlib.figure import Figure  # a second to import; a Figure needs no display

    rows = {row["label"]: row for row in content["rows"]}
    timed = [rows[one] for one in shown_rows(content["rows"], 9)[1:] if rows[one]["milliseconds"]]
    if len(timed) < 2:
        return Markup("")
    figure = Figure(figsize=(7.1, 3.4), layout="constrained")
    axis = figure.subplots()
    for row in timed:
        psnr, gmac = row["metrics"]["psnr"], row["gmac"]
        sides = [[max(psnr["mean"] - psnr["low"], 0)], [max(psnr["high"] - psnr["mean"], 0)]]
        label = f"{row['label']} ({gmac:.2f} GMAC)" if gmac else row["label"]
        axis.errorbar(row["milliseconds"], psnr["mean"], yerr=sides, fmt="o", label=label)
    axis.set(xlabel="CPU milliseconds an image", ylabel="PSNR, dB", xscale="log")
    figure.legend(loc="outside right upper", fontsize=8)
    return as_svg(figure, "PSNR against CPU milliseconds an image")


def as_svg(figure: Figure, title: str) -> Markup:
    """A figure as it stands in a page; title: what a screen reader says."""
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": title}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    content = base64.b64encode(buffer.getvalue()).decode("ascii")
    picture = Markup('<img class="chart" alt="{}" src="data:image/svg+xml;base64,{}">')
    return picture.format(title, content)
