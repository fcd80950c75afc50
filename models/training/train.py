"""Train a denoiser as the configuration says."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import yaml
from torch import Tensor

from ...factory.common.array_types import Float32s, UInt8s
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, write_atomically
from ...factory.common.settings import build
from .. import COMMAND_MARK, CONFIG_NAME, WEIGHTS_NAME
from ..data.crops import whole_image
from ..data.pairs import Batch, Data, spread
from ..data.sources import open_data
from ..networks import build_network
from ..networks.network import Network
from ..networks.rivals.adversary import AdversarialNetwork
from ..networks.weights import load_weights, save_weights
from ..pretrained import find_weights
from ..pretrained.learned_files import KEY as LEARNED_FROM
from ..settings import ModelsSettings
from .batch_reader import BatchReader, innermost_message
from .checkpoints import checkpoint_to_continue, write_checkpoint
from .cost import Cost, CostMeter, read_cost
from .loop import Row, TrainingLoop, denoised, device_of, precision_of
from .losses import Loss
from .objective import Opponent, training_loss
from .recipe import files_learned_from, full_recipe
from .validation import best_row, validate

_GAP = 4  # pixels between the images of samples.png
_SHOWN = 4  # its rows


def train(settings: ModelsSettings, config: Mapping[str, Any], command: str = "") -> Row:
    """Train, or continue, or find it done; returns the metrics row of the weights that were kept.

    config: the same settings as plain values, for config.yaml.  command: that was given, which
    config.yaml begins with and a model card prints; empty: unknown.  Writes weights.safetensors,
    config.yaml, metrics.csv, samples.png and checkpoint.ckpt into `output_folder(settings)`.
    Raises FactoryError for unusable data, configuration, folder or a loss that became NaN, and
    `Stopped` after Ctrl-C or SIGTERM, with a checkpoint of the last step.
    """
    out = output_folder(settings)
    device = device_of(settings.device)
    data = open_data(settings)
    precision: Any = precision_of(settings.train.precision, device)
    settings = replace(settings, train=replace(settings.train, precision=precision))
    # Everything that decides the weights, and nothing that does not.
    recipe = full_recipe(settings, data)
    check_writable(out, "out")
    checkpoint = checkpoint_to_continue(out, recipe, settings.resume)
    rows: list[Row] = checkpoint["rows"] if checkpoint else []
    if rows and rows[-1]["step"] == settings.train.steps:
        print(f"{out} holds this training already, finished; resume=false trains it afresh")
    else:
        # The file states the precision that was chosen, to make the same weights elsewhere.
        values = {**config, "train": {**config["train"], "precision": precision}}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        write_atomically(out / CONFIG_NAME, f"{COMMAND_MARK}{command}\n{text}".encode())
        rows = Training(settings, recipe, data, device, checkpoint).run()
    _write_samples(out, data)
    return best_row(rows)


def output_folder(settings: ModelsSettings) -> Path:
    """Where the results of a training go."""
    return Path(settings.out or Path("outputs", "models", settings.name)).expanduser()


def begun(settings: ModelsSettings) -> Network:
    """The network as training begins.  Raises FactoryError where it does not fit `start`."""
    torch.manual_seed(settings.seed)
    network = build_network(settings.model)
    if settings.start is not None:
        trained = load_weights(find_weights(settings.start))
        try:
            # A head that older weights lack begins without effect.
            fresh = {
                name: values
                for name, values in network.state_dict().items()
                if name.startswith("bearings.")
            }
            network.load_state_dict({**fresh, **trained.network.state_dict()})
        except RuntimeError as error:  # torch's message lists hundreds of tensors
            raise FactoryError(
                f"start={settings.start}: holds {dict(trained.model)}, and model says "
                f"{dict(settings.model)}; give both the same sizes"
            ) from error
    return network


class Training:
    """A training under way: its network, what it learns from, and what it writes.

    recipe: everything that decides the weights.  checkpoint: to go on from.
    Raises FactoryError for a start that does not fit the network.
    """

    def __init__(
        self,
        settings: ModelsSettings,
        recipe: Mapping[str, Any],
        data: Data,
        device: torch.device,
        checkpoint: Mapping[str, Any] | None,
    ) -> None:
        self._settings = settings
        self._recipe = recipe
        self._data = data
        self._out = output_folder(settings)
        self._meter = CostMeter(read_cost(self._out) if checkpoint else Cost())
        self._learned_from = files_learned_from(settings, data)
        self._loss: Loss = build(Loss, settings.loss, "loss")
        network = begun(settings)
        self._opponent = None
        if isinstance(network, AdversarialNetwork):
            self._opponent = Opponent(network, settings.train.learning_rate, device)
        self._loop = TrainingLoop(
            network, self._objective, settings.train, settings.seed, device, save=self._save
        )
        if checkpoint is not None:
            self._loop.restore(checkpoint)
            if self._opponent is not None:
                self._opponent.load_state_dict(checkpoint["opponent"])
        self._reader = BatchReader(settings, device, data, network.extras)

    def run(self) -> list[Row]:
        """Go on to the last step; returns the rows of all checks.

        Raises FactoryError for a loss that became NaN, unreadable data or too little memory.
        """
        try:
            self._loop.run(self._reader.after, self._check)
        except FactoryError as error:
            raise FactoryError(innermost_message(error)) from error
        except torch.OutOfMemoryError as error:
            raise FactoryError(
                "the GPU has too little memory; lower data.batch or data.patch"
            ) from error
        finally:
            self._reader.close()
        self._meter.write(self._out)
        return self._loop.rows

    def _objective(self, network: Network, batch: Batch) -> Tensor:
        return training_loss(network, batch, self._loss, self._opponent)

    def _save(self) -> None:
        """Keep the cost and a checkpoint."""
        self._meter.write(self._out)
        state = self._loop.state()
        if self._opponent is not None:
            state["opponent"] = self._opponent.state_dict()
        write_checkpoint(self._out, self._recipe, state)

    def _check(self, step: int, loss: float) -> Row:
        """Measure the network, keep its weights if they are the best yet, and all rows."""
        loop = self._loop
        row: Row = {"step": step, "loss": loss, "learning_rate": loop.learning_rate()}
        row |= validate(loop, self._data)
        rows = [*loop.rows, row]
        if best_row(rows) is row:
            facts = {**self._recipe, LEARNED_FROM: self._learned_from, "validation": row}
            save_weights(self._out / WEIGHTS_NAME, loop.average, self._settings.model, facts)
        _write_metrics(self._out / "metrics.csv", rows)
        loop.bar.set_postfix(f"loss {loss:.4f}, psnr {row['psnr']:.2f} ({row['gain_db']:+.2f} dB)")
        return row


def _write_metrics(path: Path, rows: Sequence[Row]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[-1]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())


def _write_samples(out: Path, data: Data) -> None:
    """samples.png: validation images as made, denoised and clean."""
    network = load_weights(out / WEIGHTS_NAME).network
    numbers = spread(tuple(range(len(data.validation))), _SHOWN)
    samples = [data.validation.sample(number, None) for number in numbers]
    images = [
        [sample.noisy, denoised(network, whole_image(sample, network.extras)), sample.clean]
        for sample in samples
    ]
    sheet = cv2.imencode(".png", contact_sheet(images))[1].tobytes()
    write_atomically(out / "samples.png", sheet, durable=False, key="out")


def contact_sheet(rows: Sequence[Sequence[Float32s]]) -> UInt8s:
    """(H, W) uint8 of rows of images (h, w) float32 in 0..1, those of a row of one height."""
    framed = [
        np.hstack([np.pad(image, (0, _GAP), constant_values=0.5) for image in row]) for row in rows
    ]
    width = max(line.shape[1] for line in framed)
    sheet = np.vstack([np.pad(line, ((0, 0), (0, width - line.shape[1]))) for line in framed])
    return np.asarray(np.rint(np.clip(sheet[:-_GAP, :-_GAP], 0, 1) * 255), np.uint8)
