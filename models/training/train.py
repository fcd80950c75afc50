"""Train a denoiser as the configuration says."""

from __future__ import annotations

import csv
import io
import math
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
import yaml
from torch import Tensor
from torch.utils.data import DataLoader

from ...factory.dataset.quality import psnr_db, ssim
from ...factory.errors import FactoryError
from ...factory.files import check_writable, sha256_of, write_atomically
from ...factory.settings import build
from .. import WEIGHTS_NAME
from ..data.crops import LANES, Crops, KeptSource, VisitSampler, concatenate, whole_image
from ..data.pairs import Batch, Data, Image, spread
from ..data.sources import open_data
from ..learned_files import KEY as LEARNED_FROM
from ..learned_files import described, learned_files
from ..losses import Loss
from ..networks import build_network
from ..networks.network import Network, known_extras
from ..networks.rivals.adversary import AdversarialNetwork
from ..networks.weights import load_weights, save_weights
from ..pretrained import find_weights
from ..settings import DataSettings, ModelsSettings, RenderedData
from .adversarial import Opponent
from .cost import Cost, CostMeter, read_cost
from .loop import Loop, Row, denoised, device_of, precision_of

CHECKPOINT_NAME = "checkpoint.ckpt"
_FORMAT = "simnfnd-checkpoint/5"
_FIGURES = ("psnr_noisy", "psnr", "ssim_noisy", "ssim")
_GAP = 4  # pixels between the images of samples.png
_SHOWN = 4  # its rows


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
    rows: list[Row] = checkpoint["rows"] if checkpoint else []
    if rows and rows[-1]["step"] == settings.train.steps:
        print(f"{out} holds this training already, finished; resume=false trains it afresh")
    else:
        # With the precision that was chosen: the file is to make the same weights elsewhere.
        values = {**config, "train": {**config["train"], "precision": precision}}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        write_atomically(out / "config.yaml", text.encode())
        rows = _fit(recipe, checkpoint, settings, device, data)
    network = load_weights(out / WEIGHTS_NAME).network
    numbers = spread(tuple(range(len(data.validation))), _SHOWN)
    shown = [data.validation.sample(number, None) for number in numbers]
    images = [
        [sample.noisy, denoised(network, whole_image(sample, network.extras)), sample.clean]
        for sample in shown
    ]
    sheet = cv2.imencode(".png", contact_sheet(images))[1].tobytes()
    write_atomically(out / "samples.png", sheet, durable=False, key="out")
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
            network.load_state_dict(trained.network.state_dict())
        except RuntimeError as error:  # torch's message lists hundreds of tensors
            raise FactoryError(
                f"start={settings.start}: holds {dict(trained.model)}, and model says "
                f"{dict(settings.model)}; give both the same sizes"
            ) from error
    return network


def training_loss(
    network: Network,
    batch: Batch,
    loss: Loss,
    *,
    teacher: Network | None = None,
    opponent: Opponent | None = None,
    progress: float = 0.0,
) -> Tensor:
    """The loss of a batch by whatever the network is trained with.

    progress: of the training, 0 to 1.
    """
    own_loss = network.own_loss(batch["noisy"], progress)
    if own_loss is not None:
        return own_loss
    if opponent is None:
        return taught_loss(network, batch, loss, teacher)
    assert isinstance(network, AdversarialNetwork)
    denoised = network(batch["noisy"])
    clean = completed(batch, denoised, None)["clean"]
    return opponent.adversarial_loss(network, batch, clean, denoised, loss)


def taught_loss(
    network: Network, batch: Batch, loss: Loss, teacher: Network | None = None
) -> Tensor:
    """The loss of a batch; parts of its targets are what a teacher makes of it.

    What trained weights denoise is the target (Hinton et al. 2015, here for images): what a small
    network cannot do shows as noise in the gradients when it learns from clean images alone; the
    images of a larger one are nearer to what it can do.
    """
    if not network.has_heads:
        images = network.stages(batch["noisy"], **known_extras(network, batch))
        batch = completed(batch, images[-1], teacher)
        losses = [loss(image, batch["clean"], batch) for image in images]
        return torch.stack(losses).mean()
    prediction, heads = _predicted(network, batch)
    batch = completed(batch | heads, prediction, teacher)
    return loss(prediction, batch["clean"], batch)


def completed(batch: Batch, prediction: Tensor, teacher: Network | None) -> Batch:
    """The batch with a target everywhere: `taught` of it is the teacher's image.

    Where nothing is known (NaN) the target is the prediction, which then costs nothing.
    """
    clean = batch["clean"]
    batch = dict(batch)
    if teacher is not None:
        with torch.no_grad():
            image = _predicted(teacher.to(clean.device), batch)[0].to(clean.dtype)
        mixed = torch.where(clean.isnan(), image, torch.lerp(clean, image, batch["taught"]))
        clean = torch.where(batch["taught"] > 0, mixed, clean)
    batch["clean"] = torch.where(clean.isnan(), prediction.detach(), clean)
    if "shadow_logits" in batch:
        shadow = batch["shadow"]
        predicted = torch.sigmoid(batch["shadow_logits"].detach())
        batch["shadow"] = torch.where(shadow.isnan(), predicted, shadow)
    return batch


def _predicted(network: Network, batch: Batch) -> tuple[Tensor, Batch]:
    """The image with its whole change, and the heads' output for the loss."""
    extras = known_extras(network, batch)
    if not network.has_heads:
        return network(batch["noisy"], **extras), {}
    image, logits, weight = network.with_heads(batch["noisy"], **extras)
    return image, {"shadow_logits": logits, "weight": weight}


def _fit(
    recipe: Mapping[str, Any],
    checkpoint: Mapping[str, Any] | None,
    settings: ModelsSettings,
    device: torch.device,
    data: Data,
) -> list[Row]:
    """The rows of all checks."""
    out = output_folder(settings)
    network = begun(settings)
    teacher = None
    extras = network.extras
    if settings.train.teacher is not None:
        if isinstance(network, AdversarialNetwork):
            raise FactoryError(
                f"train.teacher={settings.train.teacher}: a network with a critic does not learn "
                "from a teacher; leave it out"
            )
        teacher = load_weights(find_weights(settings.train.teacher)).network.requires_grad_(False)
        extras = tuple(dict.fromkeys((*extras, *teacher.extras)))

    meter = CostMeter(read_cost(out) if checkpoint else Cost())
    learned = _learned_files(settings, data)

    def save() -> None:
        meter.write(out)
        content = io.BytesIO()
        state = {**loop.state(), "recipe": dict(recipe), "format": _FORMAT}
        if opponent is not None:
            state["opponent"] = opponent.state_dict()
        torch.save(state, content)
        write_atomically(out / CHECKPOINT_NAME, content.getvalue(), key="out")

    def batches(step: int) -> Iterator[Batch]:
        visits.step = step
        return iter(learning)

    def check(step: int, loss: float) -> Row:
        row: Row = {"step": step, "loss": loss, "learning_rate": loop.learning_rate()}
        row |= _measured(loop, data)
        if best_row([*loop.rows, row]) is row:
            facts = {**recipe, LEARNED_FROM: learned, "validation": row}
            save_weights(out / WEIGHTS_NAME, loop.average, settings.model, facts)
        text = io.StringIO()
        writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
        writer.writeheader()
        writer.writerows([*loop.rows, row])
        write_atomically(out / "metrics.csv", text.getvalue().encode())
        shown = f"loss {loss:.4f}, psnr {row['psnr']:.2f} ({row['gain_db']:+.2f} dB)"
        loop.bar.set_postfix_str(shown)
        return row

    opponent = None
    if isinstance(network, AdversarialNetwork):
        opponent = Opponent(network, settings.train.learning_rate, device)
    loss_terms: Loss = build(Loss, settings.loss, "loss")

    def objective(network: Network, batch: Batch) -> Tensor:
        progress = loop.step / settings.train.steps
        return training_loss(
            network, batch, loss_terms, teacher=teacher, opponent=opponent, progress=progress
        )

    loop = Loop(network, objective, settings.train, settings.seed, device, save=save)
    if checkpoint is not None:
        loop.restore(checkpoint)
        if opponent is not None:
            opponent.load_state_dict(checkpoint["opponent"])
    learning, visits = _loader(settings, device, data, extras)
    try:
        loop.run(batches, check)
    except FactoryError as error:
        raise FactoryError(_innermost(error)) from error
    except torch.OutOfMemoryError as error:
        raise FactoryError(
            "the GPU has too little memory; lower data.batch or data.patch"
        ) from error
    finally:
        # The traceback of an error would keep the reading processes alive.
        stop = getattr(learning._iterator, "_shutdown_workers", lambda: None)
        stop()
    meter.write(out)
    return loop.rows


def best_row(rows: Sequence[Row]) -> Row:
    """The row of the weights that are kept: the highest PSNR; of equal ones the first."""
    return max(rows, key=lambda row: row["psnr"])


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The state, recipe and rows of a checkpoint.  Raises FactoryError when it is damaged."""
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        if content["format"] != _FORMAT:
            raise ValueError(content["format"])
        return content
    except Exception as error:
        # torch reports a damaged file with a dozen exception types.
        raise FactoryError(
            f"{path}: damaged, or of another version; delete it or train with resume=false"
        ) from error


def _measured(loop: Loop, data: Data) -> dict[str, float]:
    """Means of the figures over the validation images, one at a time: whole and of any size.

    Raises FactoryError where one of these is not a number.
    """
    figures = []
    for index in range(len(data.validation)):
        sample = data.validation.sample(index, None)
        with loop.autocast():
            denoised_image = denoised(loop.average, whole_image(sample, loop.average.extras))
        images = (sample.noisy, denoised_image)
        psnrs = [psnr_db(sample.clean, image) for image in images]
        ssims = [ssim(sample.clean, image) for image in images]
        figures.append(psnrs + ssims)
        loop.stop_if_asked()
    means = dict(zip(_FIGURES, np.mean(figures, axis=0).tolist(), strict=True))
    if not all(math.isfinite(value) for value in means.values()):
        raise FactoryError(
            f"the network returns NaN at step {loop.step}; lower train.learning_rate"
        )
    return {**means, "gain_db": means["psnr"] - means["psnr_noisy"]}


def _loader(
    settings: ModelsSettings, device: torch.device, data: Data, extras: tuple[str, ...]
) -> tuple[DataLoader[Batch], VisitSampler]:
    """What training reads from, and which visits it asks for."""
    kind = settings.data
    workers = _reading_processes(kind, device)
    shared: dict[str, Any] = {"num_workers": workers, "pin_memory": device.type != "cpu"}
    if workers:
        # spawn: a fork would copy HDF5's and torch's threads in whatever state they are.
        shared |= {"multiprocessing_context": "spawn", "persistent_workers": True}
        shared["worker_init_fn"] = _leave_ctrl_c
    source = data.learning
    if kind.reuse > 1:
        source = KeptSource(source, max(1, workers))
    crops = Crops(source, kind, settings.seed, extras)
    interval = settings.train.check_every
    visits = VisitSampler(len(source), kind, interval, settings.seed, data.learning.places)
    return DataLoader(crops, batch_sampler=visits, collate_fn=concatenate, **shared), visits


def _reading_processes(data: DataSettings, device: torch.device) -> int:
    """How many processes make the crops; 0: the training itself."""
    cores = os.cpu_count() or 1
    if data.workers != "auto":
        return data.workers
    if device.type == "cpu":
        # A network keeps every core busy, unless pairs have to be made for it.
        return 1 if isinstance(data, RenderedData) and cores > 1 else 0
    available = min(LANES, max(1, cores - 1))
    # A divisor of LANES, so that each lane stays with one process.
    return max(count for count in (1, 2, 4, 8) if count <= available)


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
    checkpoint = read_checkpoint(path)
    stored = checkpoint["recipe"]
    odd = [key for key in {**stored, **recipe} if stored.get(key) != recipe.get(key)]
    if odd:
        changes = ", ".join(f"{key} {stored.get(key)} -> {recipe.get(key)}" for key in odd)
        raise FactoryError(
            f"out={out}: holds a training with other settings ({changes}); choose another name=, "
            "or replace it with resume=false"
        )
    return checkpoint


def _recipe(settings: ModelsSettings, data: Data) -> dict[str, Any]:
    """Everything that decides the weights: the settings and the facts of the data."""
    return {**recipe_of(settings), **data.facts}


def recipe_of(settings: ModelsSettings) -> dict[str, Any]:
    """The settings that decide the weights: key -> value, as JSON would give it back."""
    groups = {
        "model": settings.model,
        "loss": settings.loss,
        "data": asdict(settings.data),
        "train": asdict(settings.train),
    }
    flat = {
        f"{group}.{key}": list(value) if isinstance(value, tuple) else value
        for group, keys in groups.items()
        for key, value in keys.items()
    }
    # How many processes read, and where the images lie, decides nothing.
    for key in ("data.workers", "data.pack", "data.folder", "data.geometry", "train.teacher"):
        flat.pop(key, None)
    # By content, where there is any.
    for key, weights in (("train.teacher", settings.train.teacher), ("start", settings.start)):
        if weights is not None:
            flat[key] = sha256_of(find_weights(weights))[:16]
    return {**flat, "seed": settings.seed}


def _learned_files(settings: ModelsSettings, data: Data) -> list[dict[str, Any]]:
    """The recordings that the weights learn from, and those that they began from or a teacher."""
    entries = described(data.recordings)
    for weights in (settings.start, settings.train.teacher):
        if weights is not None:
            entries += learned_files(find_weights(weights))
    return [entry._asdict() for entry in dict.fromkeys(entries)]


def _innermost(error: FactoryError) -> str:
    """The message itself; a reading process wraps it in the text of its traceback."""
    last = str(error).strip().splitlines()[-1]
    return last.removeprefix(f"{FactoryError.__module__}.{FactoryError.__qualname__}: ")


def contact_sheet(rows: Sequence[Sequence[Image]]) -> npt.NDArray[np.uint8]:
    """(H, W) uint8 of rows of images (h, w) float32 in 0..1, those of a row of one height."""
    framed = [
        np.hstack([np.pad(image, (0, _GAP), constant_values=0.5) for image in row]) for row in rows
    ]
    width = max(line.shape[1] for line in framed)
    sheet = np.vstack([np.pad(line, ((0, 0), (0, width - line.shape[1]))) for line in framed])
    return np.asarray(np.rint(np.clip(sheet[:-_GAP, :-_GAP], 0, 1) * 255), np.uint8)
