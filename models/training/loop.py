"""The one loop of all trainings: steps, their average, checks, and a wish to stop."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Generic, TypeVar, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from ...factory.common.array_types import Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.private_apis import move_averages
from ...factory.common.progress import Bar
from ...factory.common.seeds import stream
from ..data.pairs import Batch
from ..networks.network import Network, known_extras
from ..networks.weights import channels_last
from ..settings import TrainSettings

SAVE_EVERY_S = 120.0
"""Time between two checkpoints, seconds, where checks are further apart."""

Row = dict[str, float | int]
Module = TypeVar("Module", bound=nn.Module)
Batches = Callable[[int], Iterator[Batch]]
"""Steps done -> the batches of those up to the next check."""
Check = Callable[[int, float], Row]
"""(steps done, mean loss since the last check) -> what was measured."""


class Stopped(KeyboardInterrupt):
    """Ctrl-C or SIGTERM, after the step in progress.

    message: the line to print.  exit_code: what a shell expects.
    """

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.message = message
        self.exit_code = 128 + number


class TrainingLoop(Generic[Module]):
    """Takes the steps that the settings say and checks `average` every `check_every` of them.

    network: any module.  objective: the loss of a batch, differentiable in its weights.
    average: the network with the running average of its weights, in evaluation mode.
    step: steps done.  rows: of the checks done.
    falls_from: part of the steps after which the learning rate falls.
    save: keeps `state()` on disk; called after every check, every `SAVE_EVERY_S` seconds, and when
    the loop is stopped by Ctrl-C or SIGTERM; None keeps nothing.
    """

    def __init__(
        self,
        network: Module,
        objective: Callable[[Module, Batch], Tensor],
        settings: TrainSettings,
        seed: int,
        device: torch.device,
        *,
        label: str = "training",
        falls_from: float = 0.0,
        save: Callable[[], None] | None = None,
    ) -> None:
        self.network = channels_last(network).to(device)
        self.objective = objective
        self.settings = settings
        self.seed = seed
        self.device = device
        self.label = label
        self.falls_from = falls_from
        self.save = save
        self._is_mixed = settings.precision == "bf16-mixed"
        self._averaged = AveragedModel(network, multi_avg_fn=running_average(settings.ema))
        self.average = cast(Module, self._averaged.requires_grad_(False).eval().module)
        self.step = 0
        self.rows: list[Row] = []
        self._losses: list[Tensor] = []  # since the last check
        self._drawn: Tensor | None = None  # state of torch's random numbers
        self.bar: Any = None
        self._stop_signal = 0  # the signal that asked to stop
        # The same steps give the same weights where the device has deterministic kernels.
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
        torch.use_deterministic_algorithms(True, warn_only=True)
        self._optimizer = torch.optim.AdamW(
            network.parameters(),
            lr=settings.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=settings.weight_decay,
        )

    def run(self, batches: Batches, check: Check) -> None:
        """Go on to the last step.

        Raises Stopped, FactoryError where the loss becomes no number, and what the calls raise.
        """
        steps = self.settings.steps
        self.bar = Bar(total=steps, initial=self.step, unit="step", desc=self.label)
        with self._noting_signals(), closing(self.bar):
            while len(self.rows) * self.settings.check_every < steps:
                self._steps(batches, len(self.rows))
                loss = float(torch.stack(self._losses).mean())
                self.rows.append(check(self.step, loss))
                self._losses = []
                self._drawn = None
                if self.save is not None:
                    self.save()

    def state(self) -> dict[str, Any]:
        """All that going on needs, in types that are loaded without running code."""
        return {
            "step": self.step,
            "rows": self.rows,
            "losses": torch.stack(self._losses).cpu() if self._losses else torch.empty(0),
            "drawn": torch.get_rng_state() if self._losses else None,
            "network": self.network.state_dict(),
            "average": self._averaged.state_dict(),
            "optimizer": self._optimizer.state_dict(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken."""
        self.step = state["step"]
        self.rows = list(state["rows"])
        self._drawn = state["drawn"]
        self._losses = list(state["losses"].to(self.device))
        self.network.load_state_dict(state["network"])
        self._averaged.load_state_dict(state["average"])
        self._optimizer.load_state_dict(state["optimizer"])

    def autocast(self) -> torch.autocast:
        """The arithmetic of `train.precision`."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self._is_mixed)

    def learning_rate(self) -> float:
        """Learning rate of the next step: a linear warm-up and, at last, a cosine decay to zero."""
        steps = self.settings.steps
        warmup = self.settings.warmup
        step = self.step
        first = max(warmup, self.falls_from * steps)
        done = min(max(0.0, step - first) / max(1, steps - first), 1.0)
        cosine = 0.5 * (1 + math.cos(math.pi * done))
        return self.settings.learning_rate * (
            (step + 1) / (warmup + 1) if step < warmup else cosine
        )

    def update(self, batch: Batch) -> Tensor:
        """Take one step and return its loss.  Raises FactoryError when that is not a number."""
        for group in self._optimizer.param_groups:
            group["lr"] = self.learning_rate()
        # Autocast rounds what a convolution reads; images, targets and maps of geometry stay exact.
        with self.autocast():
            loss = self.objective(self.network, batch).float()
        if not torch.isfinite(loss):
            raise FactoryError(
                f"the loss became {loss.item()} at step {self.step}; lower train.learning_rate, "
                "or check the dataset for odd values"
            )
        self._optimizer.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.clip)
        self._optimizer.step()
        self._averaged.update_parameters(self.network)
        return loss.detach()

    def stop_if_asked(self) -> None:
        """Raise Stopped after Ctrl-C or SIGTERM, with what was done kept; also for long checks."""
        if not self._stop_signal:
            return
        said = "interrupted; nothing was written"
        if self.save is not None:
            self.save()
            said = f"interrupted after step {self.step} of {self.settings.steps}, which is kept"
            said += "; run again to go on"
        raise Stopped(said, self._stop_signal)

    @contextmanager
    def _noting_signals(self) -> Iterator[None]:
        """Notes Ctrl-C and SIGTERM, which must not cut a step; a second one ends the program."""

        def note(number: int, _: FrameType | None) -> None:
            if self._stop_signal:
                said = "interrupted at once; the last checkpoint is kept, if there is one"
                raise Stopped(said, number)
            self._stop_signal = number

        is_main = threading.current_thread() is threading.main_thread()
        wished = (signal.SIGINT, signal.SIGTERM) if is_main else ()
        before = {number: signal.signal(number, note) for number in wished}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _steps(self, batches: Batches, interval: int) -> None:
        """The steps of an interval that are left."""
        end = min((interval + 1) * self.settings.check_every, self.settings.steps)
        if self.step == end:
            return
        saved_s = time.monotonic()
        self.network.train()
        left = batches(self.step)
        # Afterwards: a loader draws a number of its own when it starts, in a resumed training too.
        torch.manual_seed(int(stream(self.seed, "torch", interval).integers(2**62)))
        if self._drawn is not None:
            torch.set_rng_state(self._drawn)
        while self.step < end:
            try:
                batch = next(left)
            except RuntimeError:
                # A reading process may have been stopped by the same Ctrl-C.
                self.stop_if_asked()
                raise
            batch = {
                name: tensor.to(self.device, non_blocking=True) for name, tensor in batch.items()
            }
            self._losses.append(self.update(batch))
            self.step += 1
            self.bar.update()
            self.stop_if_asked()
            if self.save is not None and time.monotonic() - saved_s > SAVE_EVERY_S:
                self.save()
                saved_s = time.monotonic()


def running_average(decay: float) -> Callable[..., None]:
    """Exponential average of parameters; short at first, when weights change fast."""

    @torch.no_grad()
    def update(average: list[Tensor], current: list[Tensor], count: Tensor | int) -> None:
        keep = min(decay, (1 + int(count)) / (10 + int(count)))
        move_averages(average, current, 1 - keep)

    return update


def denoised(network: Network, batch: Batch) -> Float32s:
    """(H, W) float32 in 0..1: the image of a batch of one, denoised and clipped."""
    device = next(network.parameters()).device
    known = {name: tensor.to(device) for name, tensor in known_extras(network, batch).items()}
    with torch.inference_mode():
        image = network(batch["noisy"].to(device), **known)
    return np.asarray(image[0, 0].float().clamp(0, 1).cpu().numpy(), np.float32)


def device_of(wanted: str, key: str = "device=") -> torch.device:
    """The device that `auto`, `cpu` or `gpu` means here.  Raises FactoryError without a GPU."""
    has_gpu = torch.cuda.is_available()
    if wanted == "gpu" and not has_gpu:
        raise FactoryError(f"{key}gpu: no usable GPU here; use {key}cpu")
    return torch.device("cuda" if has_gpu and wanted != "cpu" else "cpu")


def precision_of(wanted: str, device: torch.device) -> str:
    """`32-true` or `bf16-mixed`; says what `auto` became."""
    if wanted != "auto":
        return wanted
    chosen = "bf16-mixed" if has_bf16(device) else "32-true"
    print(f"train.precision=auto: {chosen}", file=sys.stderr, flush=True)
    return chosen


def has_bf16(device: torch.device) -> bool:
    """Whether the device has instructions for bfloat16, which is slow where it is emulated."""
    if device.type != "cpu":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    flags = Path("/proc/cpuinfo")
    words = flags.read_text(encoding="utf-8", errors="replace").split() if flags.exists() else []
    return "avx512_bf16" in words or "amx_bf16" in words
