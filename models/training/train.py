"""Train a denoiser as the configuration says."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
import yaml
from lightning.fabric import Fabric
from torch.utils.data import DataLoader

from ...factory.errors import FactoryError
from ...factory.files import check_writable, sha256_of, write_atomically
from .. import WEIGHTS_NAME
from ..data.crops import (
    Crops,
    KeptSource,
    VisitSampler,
    WholeImages,
    concatenate,
    whole_image_batch,
)
from ..data.pairs import Batch, windows_of
from ..data.sources import Data, open_data
from ..networks.weights import load_weights
from ..pretrained import find_weights
from ..settings import ModelsSettings, RendersData
from .beginning import build_module
from .loop import Loop
from .module import DenoisingModule, Row
from .precision import with_precision
from .results import CHECKPOINT_NAME, Results, best_row, is_stopped, read_checkpoint
from .samples import contact_sheet, write_grey

_SHOWN = 4


def train(settings: ModelsSettings, config: Mapping[str, Any]) -> Row:
    """Train, or continue, or find it done; returns the metrics row of the weights that were kept.

    config: the same settings as plain values, for config.yaml.  Writes weights.safetensors,
    config.yaml, metrics.csv, samples.png, samples/, tensorboard/ and checkpoint.ckpt into
    `output_folder(settings)`.
    Raises FactoryError for unusable data, configuration, folder or a loss that became NaN, and
    `Stopped` after Ctrl-C or SIGTERM, with a checkpoint of the last step.
    """
    out = output_folder(settings)
    accelerator = _accelerator(settings)
    data = open_data(settings)
    settings = with_precision(settings, accelerator)
    # Everything that decides the weights, and nothing that does not.
    recipe = _recipe(settings, data)
    check_writable(out, "out")
    checkpoint = _checkpoint(out, recipe, settings)
    torch.manual_seed(settings.seed)
    module = build_module(settings)
    extras = module.network.extras
    count = len(data.validation)
    shown_indices = [i * count // min(_SHOWN, count) for i in range(min(_SHOWN, count))]
    shown = [whole_image_batch(data.validation.sample(i, None), extras) for i in shown_indices]
    results = Results(
        out,
        settings.model,
        recipe,
        shown=shown[: settings.pictures],
        tensorboard=settings.tensorboard,
    )
    rows: list[Row] = checkpoint["rows"] if checkpoint else []
    finished = rows and rows[-1]["step"] == settings.train.steps
    if finished or is_stopped(rows, settings.train.patience):
        print(f"{out} holds this training already, finished; resume=false trains it afresh")
    else:
        # With the precision that was chosen: the file is to make the same weights elsewhere.
        values = {**config, "train": {**config["train"], "precision": settings.train.precision}}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        write_atomically(out / "config.yaml", text.encode())
        rows = _fit(module, results, checkpoint, settings, accelerator, data)
    network = load_weights(out / WEIGHTS_NAME).network
    write_grey(out / "samples.png", contact_sheet(network, shown))
    return best_row(rows)


def output_folder(settings: ModelsSettings) -> Path:
    """Where the results of a training go."""
    return Path(settings.out or Path("outputs", "models", settings.name)).expanduser()


def _fit(
    module: DenoisingModule,
    results: Results,
    checkpoint: Mapping[str, Any] | None,
    settings: ModelsSettings,
    accelerator: str,
    data: Data,
) -> list[Row]:
    """The rows of all checks."""
    chosen = settings.train
    assert chosen.precision != "auto"  # `with_precision` decided
    logging.getLogger("lightning.fabric").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        # Lightning's advice on precision and worker counts does not apply here.
        warnings.filterwarnings("ignore", module=r"lightning\.")
        fabric = Fabric(accelerator=accelerator, devices=1, precision=chosen.precision)

        def save() -> None:
            results.save(loop.state(), loop.progress.rows)

        loop = Loop(
            fabric,
            module,
            steps=chosen.steps,
            check_every=chosen.check_every,
            seed=settings.seed,
            save=save,
        )
        if checkpoint is not None:
            loop.restore(checkpoint)
        learning, validation, visits = _loaders(settings, accelerator, data, module)

        def batches(interval: int, done: int) -> Iterator[Batch]:
            visits.begin(interval, done)
            return iter(learning)

        def check(step: int, loss: float) -> Row:
            row: Row = {"step": step, "loss": loss, **_measured(loop, module, validation)}
            row = results.add(loop.progress.rows, row, module, module.learning_rate(step))
            loop.show(f"loss {loss:.4f}, psnr {row['psnr']:.2f} ({row['gain_db']:+.2f} dB)")
            return row

        try:
            loop.run(batches, check, lambda rows: is_stopped(rows, chosen.patience))
        except FactoryError as error:
            raise FactoryError(_innermost(error)) from error
        except torch.OutOfMemoryError as error:
            raise FactoryError(
                "the GPU has too little memory; lower data.batch or data.patch"
            ) from error
        finally:
            results.close()
    return loop.progress.rows


def _measured(
    loop: Loop, module: DenoisingModule, validation: DataLoader[Batch]
) -> dict[str, float]:
    """Means of the figures over the validation images."""
    module.eval()
    found = []
    with torch.inference_mode(), loop.fabric.autocast():
        for batch in validation:
            found.append(module.measure(loop.fabric.to_device(batch)))
            loop.stop_if_asked()
    return {name: sum(row[name] for row in found) / len(found) for name in module.FIGURES}


def _loaders(
    settings: ModelsSettings, accelerator: str, data: Data, module: DenoisingModule
) -> tuple[DataLoader[Batch], DataLoader[Batch], VisitSampler]:
    """What training and validation read from, and which visits training asks for."""
    kind, chosen = settings.data, settings.train
    if kind.workers != "auto":
        workers = kind.workers
    elif accelerator == "cpu":
        # A network keeps every core busy, unless pairs have to be made for it.
        workers = 1 if isinstance(kind, RendersData) and (os.cpu_count() or 1) > 1 else 0
    else:
        workers = min(8, max(1, (os.cpu_count() or 2) - 1))
    # spawn: a fork would copy HDF5's and torch's threads in whatever state they are.
    shared: dict[str, Any] = {"num_workers": workers, "pin_memory": accelerator != "cpu"}
    if workers:
        shared |= {"multiprocessing_context": "spawn", "persistent_workers": True}
        shared["worker_init_fn"] = _leave_ctrl_c
    reuse = kind.reuse if isinstance(kind, RendersData) else 1
    learning = KeptSource(data.learning) if reuse > 1 else data.learning
    crops = Crops(
        learning,
        crops=kind.crops,
        flip=kind.flip,
        seed=settings.seed,
        extras=_drawn_extras(module),
    )
    visits = VisitSampler(
        len(data.learning), kind, chosen.check_every, settings.seed, windows_of(data.learning)
    )
    return (
        DataLoader(crops, batch_sampler=visits, collate_fn=concatenate, **shared),
        # One at a time: whole images of any size fit, and the figures are means of images.
        DataLoader(WholeImages(data.validation, module.network.extras), None),
        visits,
    )


def _leave_ctrl_c(_: int) -> None:
    """A reading process goes on until the training has kept its checkpoint."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _drawn_extras(module: DenoisingModule) -> tuple[str, ...]:
    """What crops have to hold: the optional inputs of the network and of its teacher."""
    taught = module.teacher.network.extras if module.teacher else ()
    return tuple(dict.fromkeys((*module.network.extras, *taught)))


def _checkpoint(
    out: Path, recipe: Mapping[str, Any], settings: ModelsSettings
) -> dict[str, Any] | None:
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
    found = read_checkpoint(path)
    stored = found["recipe"]
    odd = [key for key in {**stored, **recipe} if stored.get(key) != recipe.get(key)]
    if odd:
        changes = ", ".join(f"{key} {stored.get(key)} -> {recipe.get(key)}" for key in odd)
        raise FactoryError(
            f"out={out}: holds a training with other settings ({changes}); choose another name=, "
            "or replace it with resume=false"
        )
    return found


def _recipe(settings: ModelsSettings, data: Data) -> dict[str, Any]:
    """Key -> value, as JSON would give it back."""
    chosen = {name: value for name, value in asdict(settings.data).items() if name != "workers"}
    # Where the images lie decides nothing.
    for name in ("pack", "cache", "folder", "geometry"):
        chosen.pop(name, None)
    groups = {
        "model": dict(settings.model),
        "loss": dict(settings.loss),
        "data": {name: _plain(value) for name, value in chosen.items()},
        "train": asdict(settings.train),
    }
    flat = {
        f"{group}.{key}": value for group, keys in groups.items() for key, value in keys.items()
    }
    # By content, where there is any.
    learned = settings.train
    if learned.teacher is None:
        flat = {name: value for name, value in flat.items() if not name.startswith("train.teacher")}
    if learned.teacher is not None:
        flat["train.teacher"] = sha256_of(find_weights(learned.teacher))[:16]
    if settings.start is not None:
        flat["start"] = sha256_of(find_weights(settings.start))[:16]
    return {**flat, "seed": settings.seed, **data.facts}


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _accelerator(settings: ModelsSettings) -> str:
    has_gpu = torch.cuda.is_available()
    if settings.device == "gpu" and not has_gpu:
        raise FactoryError("device=gpu: no usable GPU here; train with device=cpu")
    device = ("gpu" if has_gpu else "cpu") if settings.device == "auto" else settings.device
    return device


def _innermost(error: FactoryError) -> str:
    """The message itself; a reading process wraps it in the text of its traceback."""
    last = str(error).strip().splitlines()[-1]
    name = f"{FactoryError.__module__}.{FactoryError.__qualname__}: "
    return last.removeprefix(name)
