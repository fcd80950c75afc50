"""A report as Markdown, as JSON, and as one HTML page that needs no network and no server."""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files as resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from ...factory.common.array_types import Float32s
from ...factory.common.files import explain_os_errors, write_atomically
from ..judging.runner import Measured
from .tables import as_markdown

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Drawing:
    """An image of a section, a file beside the report.  name: of the file, .svg or .png."""

    name: str
    caption: str
    content: bytes

    @property
    def data_uri(self) -> str:
        """The file as part of a page."""
        kind = "svg+xml" if self.name.endswith(".svg") else "png"
        return f"data:image/{kind};base64," + base64.b64encode(self.content).decode("ascii")


@dataclass(frozen=True)
class Section:
    """A part of a report.  Names in `text` stand between backticks.

    tables: of text.  folded: the page opens it on a click.  printed: on the terminal, too.
    """

    title: str
    tables: Sequence[pd.DataFrame] = ()
    text: Sequence[str] = ()
    folded: bool = False
    drawings: Sequence[Drawing] = ()
    printed: bool = False


@dataclass(frozen=True)
class ComparedImages:
    """Images to compare.  images: label -> (H, W) float32 in 0..1, the noisy one first.

    psnr: label -> dB.  truth: label of the image that errors are against; '': there is none.
    """

    title: str
    images: dict[str, Float32s]
    psnr: dict[str, float] = field(default_factory=dict)
    truth: str = ""


def compared(
    measured: Measured,
    number: int,
    title: str,
    labels: Iterable[str],
    truth_label: str,
    truth: Float32s | None,
) -> ComparedImages:
    """What the rows of these labels made of an image that was kept, beside its truth if any."""
    images = {
        label: measured.images[label, number]
        for label in labels
        if (label, number) in measured.images
    }
    if truth is None:
        return ComparedImages(title, images)
    psnr_db = {label: measured.figures[label][number]["psnr"] for label in images}
    return ComparedImages(title, {**images, truth_label: truth}, psnr_db, truth_label)


def publish(
    out: Path,
    name: str,
    title: str,
    about: str,
    sections: Sequence[Section],
    *,
    facts: Mapping[str, Any],
    examples: Sequence[ComparedImages] = (),
) -> None:
    """Write <name>.md, .json and .html and the drawings of the sections; print what is to be read.

    facts: the JSON.  Raises FactoryError when the folder cannot be written to.
    """
    shown = [
        section for section in sections if section.tables or section.drawings or any(section.text)
    ]
    parts = [f"# {title}", about]
    for section in shown:
        parts.append(f"## {section.title}")
        parts += _texts(section)
        parts += [f"![{drawing.caption}]({drawing.name})" for drawing in section.drawings]
    page = _environment().get_template("report.html")
    html = page.render(
        title=title, about=about, sections=shown, examples=_data(examples), file=_own_file
    )
    data = json.dumps(facts, indent=1, allow_nan=False) + "\n"
    files: dict[str, str | bytes] = {f"{name}.json": data, f"{name}.md": _paragraphs(parts)}
    files |= {drawing.name: drawing.content for section in shown for drawing in section.drawings}
    write_files(out, {**files, f"{name}.html": html.lstrip()})
    printed = [text for section in shown if section.printed for text in _texts(section)]
    print(_paragraphs([about, *printed, f"report: {out / name}.html"]), end="")


def _texts(section: Section) -> list[str]:
    """The tables and the text of a section as Markdown."""
    return [*map(as_markdown, section.tables), *filter(None, section.text)]


def _paragraphs(texts: Sequence[str]) -> str:
    return "\n\n".join(texts) + "\n"


def write_files(out: Path, files: Mapping[str, str | bytes]) -> None:
    """Name -> content, each whole or not at all.  FactoryError where the folder cannot be made."""
    with explain_os_errors(out, "out"):
        out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        data = os.fsencode(content) if isinstance(content, str) else content
        write_atomically(out / name, data, key="out")


def as_data_uri(image: Float32s) -> str:
    """The image, (H, W) in 0..1, in 8 bits as a lossless data: URI."""
    pixels = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    _, content = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode("ascii")


def _data(examples: Sequence[ComparedImages]) -> Markup:
    """What the viewer of the page shows, as JSON; empty without examples."""
    if not examples:
        return Markup("")
    data = [
        {
            **vars(example),
            "images": {name: as_data_uri(image) for name, image in example.images.items()},
        }
        for example in examples
    ]
    # "</script>" in a name would end the element.
    return Markup(json.dumps(data).replace("<", "\\u003c"))


def _marked(text: str) -> Markup:
    """What stands between backticks in bold."""
    return Markup(re.sub(r"`([^`]*)`", r"<b>\1</b>", str(escape(text))))


def _own_file(name: str) -> Markup:
    """A style sheet or script of this folder, to stand in a page as it is."""
    return Markup(resources("simnfnd.evaluation.report").joinpath(name).read_text(encoding="utf-8"))


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("simnfnd.evaluation.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["marked"] = _marked
    return environment
