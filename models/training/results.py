"""What a training leaves in its folder: metrics, pictures, the best weights, a checkpoint."""

from __future__ import annotations

import csv
import io
import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from .. import WEIGHTS_NAME
from ..data.pairs import Batch
from ..networks.weights import save_weights
from .module import DenoisingModule, Row
from .samples import contact_sheet, write_grey

CHECKPOINT_NAME = "checkpoint.ckpt"
METRICS_NAME = "metrics.csv"
SAMPLES_FOLDER = "samples"
TENSORBOARD_FOLDER = "tensorboard"
_FORMAT = "simnfnd-checkpoint/2"


class Results:
    """Saves and shows what every validation finds, in the process that writes.

    recipe: kept in the checkpoint, so that another training is not continued by mistake.
    shown: validation images to draw each time.  tensorboard: also write its curves and pictures.
    """

    def __init__(
        self,
        out: Path,
        model: Mapping[str, Any],
        recipe: Mapping[str, Any],
        *,
        shown: Sequence[Batch] = (),
        tensorboard: bool = False,
    ) -> None:
        self.out, self.model, self.recipe = out, model, recipe
        self.shown, self.tensorboard = tuple(shown), tensorboard
        self._board: Any = None
        self._started = time.monotonic()

    def add(
        self, rows: Sequence[Row], row: Row, module: DenoisingModule, learning_rate: float
    ) -> Row:
        """The whole row of a check; keeps its weights where they are the best, and its pictures.

        rows: of the checks before.  row: step, loss and the figures of the validation.
        Raises FactoryError where one of these is not a number.
        """
        if not all(math.isfinite(row[name]) for name in module.FIGURES):
            raise FactoryError(
                f"the network returns NaN at step {row['step']}; lower train.learning_rate"
            )
        figures = {name: row[name] for name in module.FIGURES}
        row = {
            **{"step": row["step"], "loss": row["loss"], "learning_rate": learning_rate},
            **figures,
            "gain_db": row["psnr"] - row["psnr_noisy"],
        }
        every = [*rows, row]
        if best_row(every) is row:
            facts = {**self.recipe, "validation": row}
            save_weights(self.out / WEIGHTS_NAME, module.average.module, self.model, facts)
        row = {**row, "seconds": round(time.monotonic() - self._started, 1)}
        write_metrics(self.out / METRICS_NAME, [*rows, row])
        self._show(module, row)
        return row

    def save(self, state: Mapping[str, Any], rows: Sequence[Row]) -> None:
        """The checkpoint, in place of the last one in a single step."""
        content = io.BytesIO()
        # As JSON: a checkpoint is loaded without running code of it.
        words = {"rows": json.dumps(list(rows)), "recipe": json.dumps(dict(self.recipe))}
        torch.save({**state, **words, "format": _FORMAT}, content)
        write_atomically(self.out / CHECKPOINT_NAME, content.getvalue(), key="out")

    def close(self) -> None:
        """End TensorBoard's file."""
        if self._board is not None:
            self._board.close()

    def _show(self, module: DenoisingModule, row: Row) -> None:
        """The pictures, and the row for TensorBoard."""
        sheet = None
        if self.shown:
            sheet = contact_sheet(module.average.module, self.shown)
            path = self.out / SAMPLES_FOLDER / f"{row['step']:06d}.png"
            path.parent.mkdir(exist_ok=True)
            write_grey(path, sheet)
        if not self.tensorboard:
            return
        if self._board is None:
            # A second of imports, and only where curves are wanted.
            from torch.utils.tensorboard import SummaryWriter

            folder = str(self.out / TENSORBOARD_FOLDER)
            self._board = SummaryWriter(folder, purge_step=int(row["step"]))
        for name, value in row.items():
            if name != "step":
                self._board.add_scalar(name, value, row["step"])
        if sheet is not None:
            self._board.add_image("samples", sheet, row["step"], dataformats="HW")
        self._board.flush()


def best_row(rows: Sequence[Row]) -> Row:
    """The row of the weights that are kept: the highest PSNR; of equal ones the first."""
    return max(rows, key=lambda row: row["psnr"])


def is_stopped(rows: Sequence[Row], patience: int | None) -> bool:
    """Whether none of the last `patience` rows is better than the best before them."""
    if patience is None or len(rows) <= patience:
        return False
    best = best_row(rows[:-patience])["psnr"]
    return all(row["psnr"] <= best for row in rows[-patience:])


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The state, recipe and rows of a checkpoint.  Raises FactoryError when it is damaged."""
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        if content["format"] != _FORMAT:
            raise ValueError(content["format"])
        return {**content, **{name: json.loads(content[name]) for name in ("recipe", "rows")}}
    except Exception as error:
        # torch reports a damaged file with a dozen exception types.
        raise FactoryError(
            f"{path}: damaged, or of another version; delete it or train with resume=false"
        ) from error


def write_metrics(path: Path, rows: Sequence[Row]) -> None:
    """metrics.csv, one row an interval."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())
