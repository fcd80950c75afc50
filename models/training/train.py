"""Train a denoiser as the configuration says."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
import yaml
from torch import nn
from torch.utils.data import DataLoader

from ...factory.errors import FactoryError
from ...factory.files import check_writable, sha256_of, write_atomically
from .. import WEIGHTS_NAME
from ..data.crops import Crops, KeptSource, VisitSampler, concatenate, whole_image
from ..data.pairs import Batch, Data, distant_places
from ..data.sources import open_data
from ..losses import build_loss
from ..networks import build_network
from ..networks.weights import load_weights, save_weights
from ..pretrained import find_weights
from ..settings import ModelsSettings, RendersData
from .loop import Loop, device_of, precision_of
from .module import DenoisingModule, Row, Teacher, denoised

CHECKPOINT_NAME = "checkpoint.ckpt"
_FORMAT = "simnfnd-checkpoint/3"
_GAP = 4

_SHOWN = 4


def train(settings: ModelsSettings, config: Mapping[str, Any]) -> Row:
    """Train, or continue, or find it done; returns the metrics row of the weights that were kept.

    config: the same settings as plain values, for config.yaml.  Writes weights.safetensors,
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
    recipe = _recipe(settings, data)
    check_writable(out, "out")
    checkpoint = _checkpoint(out, recipe, settings)
    torch.manual_seed(settings.seed)
    module = build_module(settings)
    count = len(data.validation)
    shown = [
        whole_image(data.validation.sample(i * count // min(_SHOWN, count), None), module.extras)
        for i in range(min(_SHOWN, count))
    ]
    rows: list[Row] = checkpoint["rows"] if checkpoint else []
    if rows and rows[-1]["step"] == settings.train.steps:
        print(f"{out} holds this training already, finished; resume=false trains it afresh")
    else:
        # With the precision that was chosen: the file is to make the same weights elsewhere.
        values = {**config, "train": {**config["train"], "precision": precision}}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        write_atomically(out / "config.yaml", text.encode())
        rows = _fit(module, recipe, checkpoint, settings, device, data)
    network = load_weights(out / WEIGHTS_NAME).network
    sheet = cv2.imencode(".png", contact_sheet(network, shown))[1]
    write_atomically(out / "samples.png", sheet.tobytes(), durable=False, key="out")
    return best_row(rows)


def output_folder(settings: ModelsSettings) -> Path:
    """Where the results of a training go."""
    return Path(settings.out or Path("outputs", "models", settings.name)).expanduser()


def build_module(settings: ModelsSettings) -> DenoisingModule:
    """The network as training begins, and the way to train it.

    Raises FactoryError where the network and `start` or `train.teacher` do not fit.
    """
    network = build_network(settings.model)
    if settings.start is not None:
        trained = load_weights(find_weights(settings.start))
        try:
            network.load_state_dict(trained.network.state_dict())
        except RuntimeError as error:  # torch's message lists hundreds of tensors
            raise FactoryError(
                f"start={settings.start}: holds {dict(trained.model)}, and model says "
                f"{dict(settings.model)}; give both the same sizes"
            ) from error
    loss, chosen = build_loss(settings.loss), settings.train
    teacher = None
    if chosen.teacher is not None:
        teacher = Teacher(find_weights(chosen.teacher), chosen.teacher_share)
    return DenoisingModule(network, loss, chosen, settings.seed, teacher)


def _fit(
    module: DenoisingModule,
    recipe: Mapping[str, Any],
    checkpoint: Mapping[str, Any] | None,
    settings: ModelsSettings,
    device: torch.device,
    data: Data,
) -> list[Row]:
    """The rows of all checks."""
    out, started = output_folder(settings), time.monotonic()

    def save() -> None:
        content = io.BytesIO()
        # As JSON: a checkpoint is loaded without running code of it.
        words = {"rows": json.dumps(loop.progress.rows), "recipe": json.dumps(dict(recipe))}
        torch.save({**loop.state(), **words, "format": _FORMAT}, content)
        write_atomically(out / CHECKPOINT_NAME, content.getvalue(), key="out")

    def batches(interval: int, done: int) -> Iterator[Batch]:
        visits.begin(interval, done)
        return iter(learning)

    def check(step: int, loss: float) -> Row:
        row: Row = {"step": step, "loss": loss, **_measured(loop, module, data)}
        seconds = time.monotonic() - started
        row = _kept(out, module, recipe, settings.model, loop.progress.rows, row, seconds)
        shown = f"loss {loss:.4f}, psnr {row['psnr']:.2f} ({row['gain_db']:+.2f} dB)"
        loop.bar.set_postfix_str(shown)
        return row

    loop = Loop(module, device, save=save)
    if checkpoint is not None:
        loop.restore(checkpoint)
    learning, visits = _loader(settings, device, data, module)
    try:
        loop.run(batches, check)
    except FactoryError as error:
        raise FactoryError(_innermost(error)) from error
    except torch.OutOfMemoryError as error:
        raise FactoryError(
            "the GPU has too little memory; lower data.batch or data.patch"
        ) from error
    return loop.progress.rows


def _kept(
    out: Path,
    module: DenoisingModule,
    recipe: Mapping[str, Any],
    model: Mapping[str, Any],
    rows: Sequence[Row],
    row: Row,
    seconds: float,
) -> Row:
    """The whole row of a check, written to metrics.csv; its weights where they are the best.

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
        facts = {**recipe, "validation": row}
        save_weights(out / WEIGHTS_NAME, module.average.module, model, facts)
    row = {**row, "seconds": round(seconds, 1)}
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
    writer.writeheader()
    writer.writerows([*rows, row])
    write_atomically(out / "metrics.csv", text.getvalue().encode())
    return row


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


def _measured(loop: Loop, module: DenoisingModule, data: Data) -> dict[str, float]:
    """Means of the figures over the validation images, one at a time: whole and of any size."""
    module.eval()
    found = []
    with torch.inference_mode(), module.autocast():
        for index in range(len(data.validation)):
            batch = whole_image(data.validation.sample(index, None), module.network.extras)
            found.append(module.measure(loop.moved(batch)))
            loop.stop_if_asked()
    return {name: sum(row[name] for row in found) / len(found) for name in module.FIGURES}


def _loader(
    settings: ModelsSettings, device: torch.device, data: Data, module: DenoisingModule
) -> tuple[DataLoader[Batch], VisitSampler]:
    """What training reads from, and which visits it asks for."""
    kind, cores = settings.data, os.cpu_count() or 1
    if kind.workers != "auto":
        workers = kind.workers
    elif device.type == "cpu":
        # A network keeps every core busy, unless pairs have to be made for it.
        workers = 1 if isinstance(kind, RendersData) and cores > 1 else 0
    else:
        workers = min(8, max(1, cores - 1))
    shared: dict[str, Any] = {"num_workers": workers, "pin_memory": device.type != "cpu"}
    if workers:
        # spawn: a fork would copy HDF5's and torch's threads in whatever state they are.
        shared |= {"multiprocessing_context": "spawn", "persistent_workers": True}
        shared["worker_init_fn"] = _leave_ctrl_c
    reuse = kind.reuse if isinstance(kind, RendersData) else 1
    source = KeptSource(data.learning) if reuse > 1 else data.learning
    crops = Crops(source, crops=kind.crops, seed=settings.seed, extras=module.extras)
    steps, places = settings.train.check_every, distant_places(data.learning)
    visits = VisitSampler(len(data.learning), kind, steps, settings.seed, places)
    return DataLoader(crops, batch_sampler=visits, collate_fn=concatenate, **shared), visits


def _leave_ctrl_c(_: int) -> None:
    """A reading process goes on until the training has kept its checkpoint."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


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
    # How many processes read, and where the images lie, decides nothing.
    unimportant = ("workers", "pack", "cache", "folder", "geometry")
    groups = {
        "model": dict(settings.model),
        "loss": dict(settings.loss),
        "data": {k: v for k, v in asdict(settings.data).items() if k not in unimportant},
        "train": asdict(settings.train),
    }
    flat = {
        f"{group}.{key}": list(value) if isinstance(value, tuple) else value
        for group, keys in groups.items()
        for key, value in keys.items()
    }
    # By content, where there is any.
    if settings.train.teacher is None:
        del flat["train.teacher"], flat["train.teacher_share"]
    else:
        flat["train.teacher"] = sha256_of(find_weights(settings.train.teacher))[:16]
    if settings.start is not None:
        flat["start"] = sha256_of(find_weights(settings.start))[:16]
    return {**flat, "seed": settings.seed, **data.facts}


def _innermost(error: FactoryError) -> str:
    """The message itself; a reading process wraps it in the text of its traceback."""
    last = str(error).strip().splitlines()[-1]
    name = f"{FactoryError.__module__}.{FactoryError.__qualname__}: "
    return last.removeprefix(name)


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
