"""The callback after every interval of steps: metrics, pictures, best weights, checkpoint."""

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
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint
from torch import Tensor

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...factory.progress import progress_bar
from .. import WEIGHTS_NAME
from ..data.pairs import Batch
from ..networks.weights import save_weights
from .module import DenoisingModule, Row
from .samples import contact_sheet, write_grey

CHECKPOINT_NAME = "checkpoint.ckpt"
METRICS_NAME = "metrics.csv"
SAMPLES_FOLDER = "samples"
TENSORBOARD_FOLDER = "tensorboard"
# Existing checkpoints have this key.
_STATE_KEY = "Checks"


class ValidationCallback(Checkpoint):
    """Saves and shows what every validation finds.

    recipe: kept in the checkpoint, so that another training is not continued by mistake.
    shown: validation images to draw each time.  patience: intervals without improvement after
    which training stops.  tensorboard: also write its curves and pictures.
    """

    def __init__(
        self,
        out: Path,
        model: Mapping[str, Any],
        recipe: Mapping[str, Any],
        *,
        shown: Sequence[Batch] = (),
        patience: int | None = None,
        tensorboard: bool = False,
    ) -> None:
        self.out, self.model, self.recipe = out, model, recipe
        self.shown, self.patience, self.tensorboard = tuple(shown), patience, tensorboard
        self.rows: list[Row] = []
        self._losses: list[Tensor] = []
        self._bar: Any = None
        self._board: Any = None
        self._started = 0.0

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Open the progress bar and TensorBoard."""
        assert isinstance(module, DenoisingModule)
        self._started = time.monotonic()
        if not trainer.is_global_zero:
            return
        self._bar = progress_bar(
            total=module.settings.steps, initial=module.step, unit="step", desc="training"
        )
        if self.tensorboard:
            # A second of imports, and only where curves are wanted.
            from torch.utils.tensorboard import SummaryWriter

            folder = str(self.out / TENSORBOARD_FOLDER)
            self._board = SummaryWriter(folder, purge_step=module.step + 1)

    def on_train_batch_end(
        self, trainer: Trainer, module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Remember the loss."""
        self._losses.append(outputs["loss"].detach())
        if self._bar is not None:
            self._bar.update()

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Write the results of the interval."""
        assert isinstance(module, DenoisingModule)
        row = self._row(trainer, module)
        self._losses.clear()
        self.rows.append(row)
        if trainer.is_global_zero:
            if best_row(self.rows, module) is row:
                facts = {**self.recipe, "validation": _without_time(row)}
                save_weights(self.out / WEIGHTS_NAME, module.average.module, self.model, facts)
            write_metrics(self.out / METRICS_NAME, self.rows)
            self._show(module, row)
        trainer.should_stop = is_stopped(self.rows, module, self.patience)
        # Last: an interval that is killed before this line is repeated with the same result.
        save_checkpoint(trainer, self.out / CHECKPOINT_NAME)

    def _row(self, trainer: Trainer, module: DenoisingModule) -> Row:
        measured = {name: float(trainer.callback_metrics[name]) for name in module.figures}
        step = module.step + module.settings.check_every
        if not all(math.isfinite(value) for value in measured.values()):
            raise FactoryError(f"the network returns NaN at step {step}; lower train.learning_rate")
        row: Row = {
            "step": step,
            "loss": float(trainer.strategy.reduce(torch.stack(self._losses).mean())),
            "learning_rate": float(trainer.optimizers[0].param_groups[0]["lr"]),
            **measured,
        }
        if "psnr" in row:
            row["gain_db"] = row["psnr"] - row["psnr_noisy"]
        row["seconds"] = round(time.monotonic() - self._started, 1)
        return row

    def _show(self, module: DenoisingModule, row: Row) -> None:
        """The row on the terminal and for TensorBoard, and the pictures."""
        if self._bar is not None:
            shown = {"loss": f"{row['loss']:.4f}"}
            if "psnr" in row:
                shown["psnr"] = f"{row['psnr']:.2f} ({row['gain_db']:+.2f} dB)"
            self._bar.set_postfix(shown)
        sheet = None
        if self.shown:
            sheet = contact_sheet(module.average.module, self.shown)
            path = self.out / SAMPLES_FOLDER / f"{row['step']:06d}.png"
            path.parent.mkdir(exist_ok=True)
            write_grey(path, sheet)
        if self._board is not None:
            for name, value in row.items():
                if name != "step":
                    self._board.add_scalar(name, value, row["step"])
            if sheet is not None:
                self._board.add_image("samples", sheet, row["step"], dataformats="HW")
            self._board.flush()

    def on_train_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Leave the terminal tidy."""
        self._close()

    def on_exception(
        self, trainer: Trainer, module: LightningModule, exception: BaseException
    ) -> None:
        """Leave the terminal tidy for the error message."""
        self._close()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
        if self._board is not None:
            self._board.close()

    @property
    def state_key(self) -> str:
        """Where a checkpoint holds the state."""
        return _STATE_KEY

    def state_dict(self) -> dict[str, Any]:
        """What resuming needs, as JSON: a checkpoint is loaded without running code of it."""
        return {"rows": json.dumps(self.rows), "recipe": json.dumps(dict(self.recipe))}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue the table of metrics."""
        self.rows = json.loads(state["rows"])


def best_row(rows: Sequence[Row], module: DenoisingModule | type[DenoisingModule]) -> Row:
    """The row of the weights that are kept; of equal ones the first."""
    return max(rows, key=module.score)


def is_stopped(
    rows: Sequence[Row], module: DenoisingModule | type[DenoisingModule], patience: int | None
) -> bool:
    """Whether none of the last `patience` rows is better than the best before them."""
    if patience is None or len(rows) <= patience:
        return False
    best = max(module.score(row) for row in rows[:-patience])
    return all(module.score(row) <= best for row in rows[-patience:])


def save_checkpoint(trainer: Trainer, path: Path) -> None:
    """Lightning's checkpoint, in place of the last one in a single step."""
    temporary = path.with_suffix(".part")
    trainer.save_checkpoint(temporary)
    if trainer.is_global_zero:
        temporary.replace(path)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The recipe and the rows of a checkpoint.  Raises FactoryError when it is damaged."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        state = content["callbacks"][_STATE_KEY]
        return {name: json.loads(state[name]) for name in ("recipe", "rows")}
    except Exception as error:
        # torch reports a damaged file with a dozen exception types.
        raise FactoryError(
            f"{path}: damaged, or of another program; delete it or train with resume=false"
        ) from error


def write_metrics(path: Path, rows: Sequence[Row]) -> None:
    """metrics.csv, one row an interval."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())


def _without_time(row: Row) -> Row:
    return {name: value for name, value in row.items() if name != "seconds"}
