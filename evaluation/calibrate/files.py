"""A fit's result as configuration files that `simnfnd make` takes."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import yaml

from ...factory.config import plain
from ..realism.compare import REAL, STATISTICS, overall
from ..realism.report import number, times
from ..report.page import write_files
from ..report.tables import as_markdown, as_table
from .search import SIM, Result
from .settings import FitSettings

# What the recipe's renders, frames and files are is not part of a profile.
_PROFILE = ("sonar", "resample", "acoustics", "water")
_FORMS = ("uniform", "choice", "normal")


def report(settings: FitSettings, result: Result) -> None:
    """Print what was found, write it, and say how to use it."""
    print(table(result), "", *summary(result), sep="\n")
    for path in write(settings, result):
        print(f"written: {path}")
    print(
        f"use it: simnfnd make --config-dir {settings.folder} {usage(settings)}, or copy the files "
        "into conf/"
    )


def table(result: Result) -> str:
    """Markdown: every statistic before and after, in times the baseline."""
    before, after = (
        one.pivot(index="statistic", columns="against") for one in next(iter(result.parts.values()))
    )
    rows = []
    for name in [one for one in STATISTICS if one in after.index]:
        cells = [STATISTICS[name].label, number(after["mean", REAL][name])]
        for one in (before, after):
            cells += [number(one["mean", SIM][name]), times(one["ratio", SIM][name])]
        rows.append(cells)
    head = ("real against", "real", "recipe", "ratio", "fitted", "ratio")
    return as_markdown(as_table(head, rows))


def summary(result: Result) -> list[str]:
    """What the fit reached, in sentences."""
    lines = []
    for what, both in result.parts.items():
        old, new = (overall(one, SIM) for one in both)
        lines.append(
            f"{what}: mean ratio to the real-real baseline {old['geometric_mean_ratio']:.2f} "
            f"before, {new['geometric_mean_ratio']:.2f} after; within 2 times for "
            f"{old['within_2']:.0%} before, {new['within_2']:.0%} after"
        )
    return lines


def usage(settings: FitSettings) -> str:
    """The words that choose the result: those of the recipe that it does not hold itself."""
    held = ("experiment", "noise", *_PROFILE)
    fixed = [word for word in settings.recipe if _group(word) not in held]
    return " ".join([*map(shlex.quote, fixed), f"experiment={settings.name}"])


def _group(word: str) -> str:
    return word.lstrip("+~").split("=")[0].split(".")[0].split("@")[0]


def write(settings: FitSettings, result: Result) -> list[Path]:
    """Write noise/<name>.yaml and experiment/<name>.yaml into the folder of the fit.

    The first is the whole noise group, the second chooses it together with the sonar and the other
    groups that form the picture.  Raises FactoryError when they cannot be written.
    """
    values, real = plain(result.config), Path(settings.real).resolve().name
    story = [
        f"Fitted to {real}: {result.trials} trials (best: number {result.best}), "
        f"{result.simulated} simulated pictures.",
        f"simnfnd evaluate fit {shlex.quote(real)} name={settings.name} "
        f"trials={settings.trials} frames={settings.frames} seed={settings.seed} -- "
        + shlex.join(settings.recipe),
        *summary(result),
    ]
    comment = "".join(f"# {line}\n" for line in story)
    chosen = {key: _whole(values[key]) for key in _PROFILE if key in values}
    head = f"# @package _global_\n# simnfnd make {usage(settings)}\n#\n"
    defaults = f"defaults:\n  - override /noise: {settings.name}\n"
    texts = {
        "noise": comment + _yaml(values["noise"]),
        "experiment": head + comment + defaults + _yaml(chosen),
    }
    for group, text in texts.items():
        write_files(settings.folder / group, {f"{settings.name}.yaml": text})
    return [settings.folder / group / f"{settings.name}.yaml" for group in texts]


def _whole(node: Any) -> Any:
    """Values that replace what they are merged over: a distribution says which forms it is not."""
    if not isinstance(node, dict):
        return node
    if node and set(node) <= set(_FORMS):
        return {**dict.fromkeys(_FORMS), **node}
    return {key: _whole(value) for key, value in node.items()}


def _yaml(values: dict[str, Any]) -> str:
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=100)
