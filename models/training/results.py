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

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from .. import WEIGHTS_NAME
from ..data.pairs import Batch
from ..networks.network import Network, known_extras
from ..networks.weights import save_weights
from .module import DenoisingModule, Row

CHECKPOINT_NAME = "checkpoint.ckpt"
_FORMAT = "simnfnd-checkpoint/3"
_GAP = 4


class Results:
    """Saves and shows what every validation finds.

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

    def add(self, rows: Sequence[Row], row: Row, module: DenoisingModule) -> Row:
        """The whole row of a check; keeps its weights where they are the best, and its pictures.

        rows: of the checks before.  row: step, loss and the figures of the validation.
        Raises FactoryError where one of these is not a number.
        """
        figures = {name: row[name] for name in module.FIGURES}
        if not all(math.isfinite(value) for value in figures.values()):
            raise FactoryError(
                f"the network returns NaN at step {row['step']}; lower train.learning_rate"
            )
        step = int(row["step"])
        row = {
            **{"step": step, "loss": row["loss"], "learning_rate": module.learning_rate(step)},
            **figures,
            "gain_db": row["psnr"] - row["psnr_noisy"],
        }
        if best_row([*rows, row]) is row:
            facts = {**self.recipe, "validation": row}
            save_weights(self.out / WEIGHTS_NAME, module.average.module, self.model, facts)
        row = {**row, "seconds": round(time.monotonic() - self._started, 1)}
        text = io.StringIO()
        writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
        writer.writeheader()
        writer.writerows([*rows, row])
        write_atomically(self.out / "metrics.csv", text.getvalue().encode())
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
            (self.out / "samples").mkdir(exist_ok=True)
            write_grey(self.out / "samples" / f"{row['step']:06d}.png", sheet)
        if not self.tensorboard:
            return
        if self._board is None:
            # A second of imports, and only where curves are wanted.
            from torch.utils.tensorboard import SummaryWriter

            folder = str(self.out / "tensorboard")
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


def denoised(network: nn.Module, batch: Batch) -> npt.NDArray[np.float32]:
    """(H, W) float32 in 0..1: the image of a batch of one, denoised and clipped."""
    assert isinstance(network, Network)
    device = next(network.parameters()).device
    known = {name: one.to(device) for name, one in known_extras(network, batch).items()}
    with torch.inference_mode():
        image = network(batch["noisy"].to(device), **known)
    return np.asarray(image[0, 0].float().clamp(0, 1).cpu().numpy(), np.float32)


def contact_sheet(network: nn.Module, batches: Sequence[Batch]) -> npt.NDArray[np.uint8]:
    """(H, W) uint8: noisy | denoised (| clean), one row a batch of one, all of the first's size."""
    lines: list[npt.NDArray[np.float32]] = []
    for batch in batches:
        known = [batch[name][0, 0].numpy() for name in ("noisy", "clean") if name in batch]
        images = [known[0], denoised(network, batch), *known[1:]]
        gap = np.full((len(images[0]), _GAP), 0.5, np.float32)
        line = np.concatenate([part for image in images for part in (gap, image)][1:], axis=1)
        width = lines[0].shape[1] if lines else line.shape[1]
        line = np.pad(line[:, :width], ((0, 0), (0, max(0, width - line.shape[1]))))
        lines += [np.full((_GAP, width), 0.5, np.float32), line]
    sheet = np.concatenate(lines[1:])
    return np.asarray(np.rint(np.clip(sheet, 0, 1) * 255), dtype=np.uint8)


def write_grey(path: Path, image: npt.NDArray[np.uint8]) -> None:
    """Write a picture as PNG, whole or not at all."""
    write_atomically(path, cv2.imencode(".png", image)[1].tobytes(), durable=False, key="out")
