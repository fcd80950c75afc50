"""Train a denoiser on the pairs of a dataset."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import yaml
from lightning.pytorch import Trainer
from torch.utils.data import DataLoader

from factory.errors import FactoryError
from factory.shards.files import check_writable, write_atomically
from models import build_network
from models.data import Crops, Draws, PairTable, SampleRef, Whole, hold_out, read_table, spread
from models.losses import build_loss
from models.samples import write_samples
from models.settings import ModelsSettings
from models.training import (
    CHECKPOINT_NAME,
    Checks,
    Training,
    read_checkpoint,
)
from models.weights import WEIGHTS_NAME, load_weights

_SHOWN = 4


def train(settings: ModelsSettings, config: Mapping[str, Any]) -> dict[str, float | int]:
    """Train, or continue, or find it done; returns the metrics row of the weights that were kept.

    config: the same settings as plain values, for config.yaml.  Writes weights.safetensors,
    config.yaml, metrics.csv, samples.png and checkpoint.ckpt into `output_folder(settings)`.
    Raises FactoryError for an unusable dataset, configuration, folder or a loss that became NaN.
    """
    out = output_folder(settings)
    table = read_table(settings.dataset.dir, "train")
    if settings.data.patch > min(table.height, table.width):
        raise FactoryError(
            f"data.patch={settings.data.patch} is larger than the images of {settings.dataset.dir} "
            f"({table.height}x{table.width}); choose at most {min(table.height, table.width)}"
        )
    if min(table.height, table.width) < 11:
        raise FactoryError(
            f"dataset={settings.dataset.dir}: images of {table.height}x{table.width} are too small"
        )
    learning, validation = hold_out(table.samples, settings.data.validation, settings.seed)
    validation = spread(validation, settings.data.validation_limit)
    # Everything that decides the weights, and nothing that does not.
    recipe = _recipe(settings, table)
    check_writable(out, "out")
    checkpoint = _checkpoint(out, recipe, settings)
    accelerator = _accelerator(settings)
    torch.manual_seed(settings.seed)
    network = build_network(settings.model)
    module = Training(network, build_loss(settings.loss), settings.train)
    checks = Checks(out, settings.model, recipe)
    done = read_checkpoint(checkpoint)["rows"] if checkpoint else []
    if done and done[-1]["step"] == settings.train.steps:
        print(f"{out} holds this training already, finished; resume=false trains it afresh")
        checks.rows = done
    else:
        text = yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True)
        write_atomically(out / "config.yaml", text.encode())
        _fit(module, checks, checkpoint, settings, accelerator, learning, validation)
    write_samples(
        out / "samples.png", load_weights(out / WEIGHTS_NAME).network, spread(validation, _SHOWN)
    )
    return checks.best


def output_folder(settings: ModelsSettings) -> Path:
    """Where the results of a training go."""
    return Path(settings.out or Path("outputs", "models", settings.name)).expanduser()


def _fit(
    module: Training,
    checks: Checks,
    checkpoint: Path | None,
    settings: ModelsSettings,
    accelerator: str,
    learning: tuple[SampleRef, ...],
    validation: tuple[SampleRef, ...],
) -> None:
    data, chosen = settings.data, settings.train
    if data.workers == "auto":
        workers = 0 if accelerator == "cpu" else min(8, max(1, (os.cpu_count() or 2) - 1))
    else:
        workers = data.workers
    # spawn: a fork would copy HDF5's and torch's threads in whatever state they are.
    shared: dict[str, Any] = {"num_workers": workers, "pin_memory": accelerator != "cpu"}
    if workers:
        shared |= {"multiprocessing_context": "spawn", "persistent_workers": True}
    crops = Crops(learning, patch=data.patch, flip=data.flip, seed=settings.seed)
    draws = Draws(len(learning), chosen.check_every * data.batch, settings.seed)
    with warnings.catch_warnings():
        # Lightning's advice on loggers, worker counts and checkpoints does not apply here.
        warnings.filterwarnings("ignore", module=r"lightning\.")
        logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
        trainer = Trainer(
            accelerator=accelerator,
            devices=1,
            precision=chosen.precision,
            max_epochs=chosen.steps // chosen.check_every,
            gradient_clip_val=chosen.clip,
            callbacks=[checks],
            default_root_dir=str(checks.out),
            logger=False,
            num_sanity_val_steps=0,
            deterministic="warn",
            enable_progress_bar=False,
            enable_model_summary=False,
        )
        try:
            trainer.fit(
                module,
                DataLoader(crops, data.batch, sampler=draws, **shared),
                # One at a time: whole images of any size fit, and the figures are means of images.
                DataLoader(Whole(validation), 1),
                ckpt_path=checkpoint,
                weights_only=True,
            )
        except FactoryError as error:
            raise FactoryError(_innermost(error)) from error
        except torch.OutOfMemoryError as error:
            raise FactoryError(
                "the GPU has too little memory; lower data.batch or data.patch"
            ) from error
        except SystemExit as error:
            # Lightning's answer to Ctrl-C.
            raise KeyboardInterrupt from error


def _checkpoint(out: Path, recipe: Mapping[str, Any], settings: ModelsSettings) -> Path | None:
    """The checkpoint to continue from, or None to start; FactoryError rather than mix trainings."""
    path = out / CHECKPOINT_NAME
    if not settings.resume:
        path.unlink(missing_ok=True)
        return None
    if not path.exists():
        if (out / WEIGHTS_NAME).exists():
            raise FactoryError(
                f"out={out}: holds weights but no checkpoint to continue from; choose another "
                "name=, or replace them with resume=false"
            )
        return None
    stored = read_checkpoint(path)["recipe"]
    odd = [key for key in {**stored, **recipe} if stored.get(key) != recipe.get(key)]
    if odd:
        changes = ", ".join(f"{key} {stored.get(key)} -> {recipe.get(key)}" for key in odd)
        raise FactoryError(
            f"out={out}: holds a training with other settings ({changes}); choose another name=, "
            "or replace it with resume=false"
        )
    return path


def _recipe(settings: ModelsSettings, table: PairTable) -> dict[str, Any]:
    data, chosen = settings.data, settings.train
    groups = {
        "model": dict(settings.model),
        "loss": dict(settings.loss),
        "data": {
            name: getattr(data, name)
            for name in ("patch", "batch", "flip", "validation", "validation_limit")
        },
        "train": {name: getattr(chosen, name) for name in chosen.__dataclass_fields__},
    }
    flat = {
        f"{group}.{key}": value for group, keys in groups.items() for key, value in keys.items()
    }
    return {
        **flat,
        "seed": settings.seed,
        "dataset.config_hash": table.config_hash,
        "dataset.pairs": len(table.samples),
        "dataset.image": [table.height, table.width],
    }


def _accelerator(settings: ModelsSettings) -> str:
    has_gpu = torch.cuda.is_available()
    if settings.device == "gpu" and not has_gpu:
        raise FactoryError("device=gpu: no usable GPU here; train with device=cpu")
    device = ("gpu" if has_gpu else "cpu") if settings.device == "auto" else settings.device
    if device == "cpu" and settings.train.precision == "16-mixed":
        raise FactoryError("train.precision=16-mixed needs a GPU; on a CPU use 32-true")
    return device


def _innermost(error: FactoryError) -> str:
    """The message itself; a reading process wraps it in the text of its traceback."""
    last = str(error).strip().splitlines()[-1]
    name = f"{FactoryError.__module__}.{FactoryError.__qualname__}: "
    return last.removeprefix(name)
