"""The HTML pages: Jinja2 templates in templates/, everything from outside escaped."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files as resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ..methods.method import shown
from . import tables
from .names import METRIC_NAMES, written, written_p


def render(template: str, filters: Mapping[str, Any] | None = None, **values: Any) -> str:
    """A page as text.  filters: further ones that the template uses."""
    environment = _environment().overlay()
    environment.filters = {**environment.filters, **(filters or {})}
    return environment.get_template(template).render(**values).lstrip()


def own_file(name: str) -> Markup:
    """A style sheet or script of this folder, to stand in a page as it is."""
    text = resources("simnfnd.evaluation.report").joinpath(name).read_text(encoding="utf-8")
    return Markup(text)


def chosen(row: Mapping[str, Any]) -> str:
    """Parameters of a row, and its levels where it has them."""
    parts = [shown(row["parameters"]).strip(" ()")]
    if row.get("levels"):
        parts.append("gain {gain:.2f}, offset {offset:+.3f}".format(**row["levels"]))
    return "; ".join(part for part in parts if part)


def _differences(differs: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in differs.items())[:80]


@lru_cache(maxsize=1)
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("simnfnd.evaluation.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"METRICS": METRIC_NAMES, "own_file": own_file}
    environment.tests["finite"] = math.isfinite
    environment.filters |= {
        "chosen": chosen,
        "differences": _differences,
        "interval": tables.interval,
        "percent": tables.percent,
        "written": written,
        "written_p": written_p,
    }
    return environment
