"""The Lightning side of training: one module, and one callback that checks, logs and saves."""

from __future__ import annotations

import csv
import io
import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from factory.errors import FactoryError
from factory.shards.files import write_atomically
from models.data import Batch
from models.losses import Loss
from models.quality import psnr_db, ssim
from models.settings import TrainSettings
from models.weights import WEIGHTS_NAME, channels_last, save_weights

CHECKPOINT_NAME = "checkpoint.ckpt"
METRICS_NAME = "metrics.csv"


class Training(LightningModule):
    """A network, the running average of its weights, and how a step is made.

    The average is what validation measures and what is saved for use.
    """

    def __init__(self, network: nn.Module, loss: Loss, settings: TrainSettings) -> None:
        super().__init__()
        self.network = channels_last(network)
        self.average = AveragedModel(self.network, multi_avg_fn=_running_average(settings.ema))
        self.average.requires_grad_(False)
        self.loss, self.settings = loss, settings

    def training_step(self, batch: Batch, _: int) -> Tensor:
        """The loss of one batch of crops; FactoryError when it is not a number."""
        loss = self.loss(self.network(batch["noisy"]), batch["clean"])
        if not torch.isfinite(loss):
            raise FactoryError(
                f"the loss became {loss.item()} at step {self.global_step}; lower "
                "train.learning_rate, or check the dataset for odd values"
            )
        return loss

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Let the average follow the weights."""
        self.average.update_parameters(self.network)

    def validation_step(self, batch: Batch, _: int) -> None:
        """Quality of the whole validation images before and after denoising."""
        noisy, clean = batch["noisy"], batch["clean"]
        denoised = self.average(noisy).float().clamp(0, 1)
        values = {
            "psnr_noisy": psnr_db(noisy, clean),
            "psnr": psnr_db(denoised, clean),
            "ssim_noisy": ssim(noisy, clean),
            "ssim": ssim(denoised, clean),
        }
        self.log_dict(
            {name: value.mean() for name, value in values.items()},
            on_epoch=True,
            batch_size=len(noisy),
            sync_dist=True,
        )

    def configure_optimizers(self) -> Any:
        """AdamW with a linear warm-up and a cosine fall to zero, counted in steps."""
        chosen = self.settings
        optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=chosen.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=chosen.weight_decay,
        )
        rate = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: rate_factor(step, chosen.warmup, chosen.steps)
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": rate, "interval": "step"}}


class Checks(Checkpoint):
    """After every interval of steps: a row of metrics, the best weights so far, a checkpoint.

    `recipe` goes into the checkpoint, so that another training is not continued by mistake.
    """

    def __init__(self, out: Path, model: Mapping[str, Any], recipe: Mapping[str, Any]) -> None:
        self.out, self.model, self.recipe = out, model, recipe
        self.rows: list[dict[str, float | int]] = []
        self._losses: list[Tensor] = []
        self._bar: tqdm[Any] | None = None
        self._started = 0.0

    @property
    def best(self) -> dict[str, float | int]:
        """The row of the best validation PSNR."""
        return max(self.rows, key=lambda row: row["psnr"])

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Show how far training is."""
        total, done = int(trainer.estimated_stepping_batches), trainer.global_step
        self._bar = tqdm(total=total, initial=done, unit="step", desc="training")
        self._started = time.monotonic()

    def on_train_batch_end(
        self, trainer: Trainer, module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Remember the loss."""
        self._losses.append(outputs["loss"].detach())
        if self._bar is not None:
            self._bar.update()

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Write what this interval has brought."""
        assert isinstance(module, Training)
        measured = {name: float(value) for name, value in trainer.callback_metrics.items()}
        row: dict[str, float | int] = {
            "step": trainer.global_step,
            "loss": float(torch.stack(self._losses).mean()),
            "learning_rate": float(trainer.optimizers[0].param_groups[0]["lr"]),
            **{name: measured[name] for name in ("psnr_noisy", "psnr", "ssim_noisy", "ssim")},
            "gain_db": measured["psnr"] - measured["psnr_noisy"],
            "seconds": round(time.monotonic() - self._started, 1),
        }
        if not math.isfinite(measured["psnr"]):
            raise FactoryError(
                f"the network returns NaN at step {trainer.global_step}; lower train.learning_rate"
            )
        self._losses.clear()
        self.rows.append(row)
        if self._bar is not None:
            self._bar.set_postfix(
                loss=f"{row['loss']:.4f}", psnr=f"{row['psnr']:.2f} ({row['gain_db']:+.2f} dB)"
            )
        if trainer.is_global_zero:
            if self.best is row:
                facts = {**self.recipe, "validation": _without_time(row)}
                save_weights(self.out / WEIGHTS_NAME, module.average.module, self.model, facts)
            write_metrics(self.out / METRICS_NAME, self.rows)
        # Last: whatever is killed before this line is done again, with the same result.
        save_checkpoint(trainer, self.out / CHECKPOINT_NAME)

    def on_train_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Leave the terminal tidy."""
        self._close_bar()

    def on_exception(
        self, trainer: Trainer, module: LightningModule, exception: BaseException
    ) -> None:
        """Leave the terminal tidy for the one line that says what went wrong."""
        self._close_bar()

    def _close_bar(self) -> None:
        if self._bar is not None:
            self._bar.close()

    def state_dict(self) -> dict[str, Any]:
        """What resuming needs, as JSON: a checkpoint is loaded without running code of it."""
        return {"rows": json.dumps(self.rows), "recipe": json.dumps(dict(self.recipe))}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue the table of metrics."""
        self.rows = json.loads(state["rows"])


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
        state = content["callbacks"][Checks.__qualname__]
        return {name: json.loads(state[name]) for name in ("recipe", "rows")}
    except Exception as error:
        # torch reports a damaged file with a dozen exception types.
        raise FactoryError(
            f"{path}: damaged, or of another program; delete it or train with resume=false"
        ) from error


def write_metrics(path: Path, rows: list[dict[str, float | int]]) -> None:
    """metrics.csv, one row an interval."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())


def rate_factor(step: int, warmup: int, steps: int) -> float:
    """Share of the full learning rate at a step: linear warm-up, then a cosine to zero."""
    if step < warmup:
        return (step + 1) / (warmup + 1)
    done = (step - warmup) / max(1, steps - warmup)
    return 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


def _running_average(decay: float) -> Any:
    """Exponential average of parameters; short at first, when the weights still travel far."""

    @torch.no_grad()
    def update(average: list[Tensor], current: list[Tensor], count: Tensor | int) -> None:
        keep = min(decay, (1 + int(count)) / (10 + int(count)))
        torch._foreach_lerp_(average, current, 1 - keep)

    return update


def _without_time(row: Mapping[str, float | int]) -> dict[str, float | int]:
    return {name: value for name, value in row.items() if name != "seconds"}
