"""A fit's result as configuration files that `simnfnd make` takes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ...factory.config import plain
from ..realism.compare import overall
from ..realism.report import number, times
from ..report.page import write_files
from ..report.tables import as_markdown, as_table
from .search import Result
from .settings import FitSettings

# What the recipe's renders, frames and files are is not part of a profile.
_PROFILE = ("sonar", "resample", "acoustics", "water")
_FORMS = ("uniform", "choice", "normal")


def report(settings: FitSettings, result: Result) -> None:
    """Print what was found, write it, and say how to use it."""
    print(table(result))
    for path in write(settings, result):
        print(f"written: {path}")
    print(
        f"use it: simnfnd make --config-dir {settings.folder} {usage(settings)}, or copy the files "
        "into conf/"
    )


def table(result: Result) -> str:
    """Markdown: every statistic before and after, in times the baseline."""
    rows = [
        (
            after.statistic.label,
            number(after.baseline.mean),
            number(before.distance["sim"].mean),
            times(before.ratio("sim")),
            number(after.distance["sim"].mean),
            times(after.ratio("sim")),
        )
        for before, after in zip(result.before, result.after, strict=True)
    ]
    head = ("real against", "real", "recipe", "ratio", "fitted", "ratio")
    return "\n".join([as_markdown(as_table(head, rows)), "", *summary(result)])


def summary(result: Result) -> list[str]:
    """What the fit reached, in sentences."""
    searched, held_out = result.real
    parts = [(f"{searched} real pictures of the search", result.before, result.after)]
    if result.held_out is not None:
        parts.append((f"{held_out} real pictures kept from it", *result.held_out))
    lines = []
    for what, before, after in parts:
        old, new = overall(before, "sim"), overall(after, "sim")
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
    values = plain(result.config)
    command = (
        f"simnfnd evaluate fit {shlex.quote(Path(settings.real).name)} name={settings.name} "
        f"trials={settings.trials} frames={settings.frames} seed={settings.seed} -- "
        + shlex.join(settings.recipe)
    )
    story = [
        f"Fitted to {Path(settings.real).resolve().name}: {result.trials} trials (best: number "
        f"{result.best}), {result.simulated} simulated pictures.",
        command,
        *summary(result),
    ]
    noise = settings.folder / "noise" / f"{settings.name}.yaml"
    recipe = settings.folder / "experiment" / f"{settings.name}.yaml"
    chosen = {key: _whole(values[key]) for key in _PROFILE if key in values}
    head = f"# @package _global_\n# simnfnd make {usage(settings)}\n#\n"
    defaults = f"defaults:\n  - override /noise: {settings.name}\n"
    texts = {
        noise: _comment(story) + _yaml(values["noise"]),
        recipe: head + _comment(story) + defaults + _yaml(chosen),
    }
    for path, text in texts.items():
        write_files(path.parent, {path.name: text})
    return [noise, recipe]


def _whole(node: Any) -> Any:
    """Values that replace what they are merged over: a distribution says which forms it is not."""
    if not isinstance(node, dict):
        return node
    if node and set(node) <= set(_FORMS):
        return {**dict.fromkeys(_FORMS), **node}
    return {key: _whole(value) for key, value in node.items()}


def _comment(lines: list[str]) -> str:
    return "".join(f"# {line}\n" for line in lines)


def _yaml(values: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(values), sort_keys=False, default_flow_style=None, width=100)
