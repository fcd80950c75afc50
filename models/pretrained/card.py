"""Model cards: what a weights file is, how it was made, and what it is worth, from the run itself.

A card names its file and its recipe by hashes, so a test can tell whether the three belong
together.
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...factory import __version__
from ...factory.common.errors import FactoryError
from .. import COMMAND_MARK, CONFIG_NAME
from .learned_files import KEY as LEARNED_FROM
from .learned_files import as_front_matter, entries_of

_METRICS_NAME = "metrics.csv"
_COST_NAME = "cost.json"
_CURVE_ROWS = 20  # of the learning curve, at most
_RECIPE_GROUPS = ("model.", "loss.", "data.", "train.")
# Known by their content alone, or chosen by the device.
_NO_SETTINGS = ("data.recordings", "train.precision", "train.teacher")
# Settings that weights which ship are older than, by the value that changes nothing.
_ADDED_LATER = {
    "model.average_cells": False,
    "model.bearings": False,
    "model.even_level": False,
    "data.displays": 0.0,
    "data.radial": 0.0,
    "loss.interference": 1.0,
    "loss.ssim": 0.0,
}

_CARD = """---
license: apache-2.0
library_name: simnfnd
pipeline_tag: image-to-image
tags: [sonar, denoising, forward-looking-sonar]
{learned}---

# {name}

A denoiser for forward-looking sonar images, made by `simnfnd train` of SimNFND {version}. `simnfnd denoise IN... --out DIR --weights {name}` uses it.

## File

{file}

## Recipe

{command}{recipe}

`start` and `train.teacher` name weights by their hash. Recordings that it learned from: {recordings}.

## Learning curve

{curve}

## Figures

{figures}

Figures under `validation` are of images that it never trained on, which chose the step that was kept. Where images had a part in choosing the recipe, their figures are optimistic.

## Limits

An image whose noise, geometry or grey scale differs from what is described above may come out worse than it went in. Small targets unlike anything in the training scenes can be smoothed away; do not measure on denoised images what you could measure on the originals.
"""  # noqa: E501


@dataclass(frozen=True)
class CardFile:
    """The file that a card describes.

    sha256: of the file.  source_sha256: of the weights in 32 bits that it was rounded from.
    gmac: 1e9 multiply-accumulates for an image of 256x256.
    """

    name: str
    sha256: str
    source_sha256: str
    parameters: int
    gmac: float
    size_mb: float


def recipe_digest(training: Mapping[str, Any]) -> str:
    """16 hex digits that change with the settings of a training, but not with its data.

    training: the facts of a weights file, or `training.train.recipe_of` of a configuration.
    """
    settings = {
        key: value
        for key, value in training.items()
        if key == "seed" or (key.startswith(_RECIPE_GROUPS) and key not in _NO_SETTINGS)
    }
    for key, earlier in _ADDED_LATER.items():
        if settings.get(key) == earlier:
            del settings[key]
    text = json.dumps(settings, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def write_card(
    file: CardFile,
    model: Mapping[str, Any],
    training: Mapping[str, Any],
    run: Path,
    reports: Sequence[Path],
) -> str:
    """Compose the card as Markdown.

    model, training: of the weights file.  run: the folder of the training, whose metrics and cost
    go in where they are there.  reports: real.json or report.json of evaluations.
    Raises FactoryError for a report or a curve that cannot be read.
    """
    about = {
        "SHA-256": file.sha256,
        "rounded from": file.source_sha256,
        "recipe digest": recipe_digest(training),
        "parameters": f"{file.parameters:,}",
        "GMAC for a 256x256 image": f"{file.gmac:.2f}",
        "size": f"{file.size_mb:.2f} MB, 16-bit safetensors",
        **_read_cost(run),
    }
    learned = entries_of(training)
    settings = {key: value for key, value in training.items() if key != LEARNED_FROM}
    figures = [_figures_of(report) for report in reports]
    return _CARD.format(
        name=file.name,
        version=__version__,
        file=_table(["what", ""], list(about.items())),
        command=_command_of(run / CONFIG_NAME),
        recipe=_settings_table({"model": dict(model), **settings}),
        learned=as_front_matter(learned),
        recordings=", ".join(entry.file for entry in learned) or "none",
        curve=_curve_of(run / _METRICS_NAME),
        figures="\n\n".join(figures) or "None were given (`--figures`).",
    )


def _command_of(config: Path) -> str:
    """A sentence with the command that a training was started with, where it is known."""
    if not config.is_file():
        return ""
    first_line = config.read_text(encoding="utf-8").partition("\n")[0]
    if not first_line.startswith(COMMAND_MARK):
        return ""
    return f"`{first_line.removeprefix(COMMAND_MARK)}` makes these weights.\n\n"


def _read_cost(run: Path) -> dict[str, str]:
    path = run / _COST_NAME
    if not path.is_file():
        return {}
    try:
        cost = json.loads(path.read_text(encoding="utf-8"))
        hours = f"{cost['cpu_s'] / 3600:.2f}"
        sittings = "one sitting" if cost["sittings"] == 1 else f"{cost['sittings']} sittings"
        elapsed = f"{cost['elapsed_s'] / 3600:.2f} h elapsed in {sittings}"
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FactoryError(f"{path}: damaged; delete it to leave the cost out") from error
    return {"CPU hours": f"{hours}, {elapsed}"}


def _settings_table(facts: Mapping[str, Any]) -> str:
    rows = []
    for key, value in facts.items():
        shown = value if isinstance(value, str) else json.dumps(value)
        rows.append((f"`{key}`", shown))
    return _table(["key", "value"], rows)


def _curve_of(path: Path) -> str:
    """The checks of a training, evenly thinned."""
    if not path.is_file():
        return "The file was exported without the folder of its training."
    try:
        with path.open(encoding="utf-8", newline="") as file:
            checks = list(csv.DictReader(file))
        every = -(-len(checks) // _CURVE_ROWS)
        shown = checks[every - 1 :: every] if checks else []
        if checks and shown[-1] is not checks[-1]:
            shown.append(checks[-1])
        rows = [
            (
                check["step"],
                f"{float(check['loss']):.4f}",
                f"{float(check['psnr_noisy']):.2f} / {float(check['ssim_noisy']):.3f}",
                f"{float(check['psnr']):.2f} / {float(check['ssim']):.3f}",
            )
            for check in shown
        ]
    except (OSError, ValueError, KeyError, csv.Error) as error:
        raise FactoryError(f"{path}: damaged; delete it to leave the curve out") from error
    head = ["step", "loss", "validation as made, dB / SSIM", "denoised, dB / SSIM"]
    return _table(head, rows)


def _figures_of(path: Path) -> str:
    """Noisy, the best filter and the networks of a report."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        name = report["name"] if "name" in report else report["facts"]["dataset"]
        rows = _report_rows(report)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FactoryError(
            f"--figures {path}: no report; give real.json of `simnfnd evaluate real` or "
            "report.json of `simnfnd evaluate`"
        ) from error
    return f"### {name}\n\n" + _table(["row", "PSNR, dB", "SSIM"], rows)


def _report_rows(report: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Label, PSNR and SSIM of the noisy images, the best filter and the networks."""
    measured = [row for row in report["rows"] if row["lost"] is None and "psnr" in row["metrics"]]
    filters = [row for row in measured if row["kind"] == "baseline"]
    best = max(filters, key=lambda row: row["metrics"]["psnr"]["mean"], default=None)
    rows = []
    for row in measured:
        if row is best or row["kind"] in ("noisy", "network"):
            psnr_db = row["metrics"]["psnr"]["mean"]
            ssim = row["metrics"]["ssim"]["mean"]
            rows.append((row["label"], f"{psnr_db:.2f}", f"{ssim:.3f}"))
    return rows


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
