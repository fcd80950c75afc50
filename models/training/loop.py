"""The one loop of training, distilling and adapting: steps, checks, a wish to stop, the device."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.seeds import stream
from ..data.pairs import Batch
from .module import DenoisingModule, Row

SAVE_EVERY_S = 120.0
"""Time between two checkpoints, seconds, where checks are further apart."""

Batches = Callable[[int, int], Iterator[Batch]]
"""(number of the interval, steps of it that are done) -> the batches of its other steps."""
Check = Callable[[int, float], Row]
"""(steps done, mean loss since the last check) -> what was measured."""


class Stopped(KeyboardInterrupt):
    """Ctrl-C or SIGTERM, after the step in progress.

    said: the line to print.  exit_code: what a shell expects.
    """

    def __init__(self, said: str, number: int) -> None:
        super().__init__(said)
        self.said, self.exit_code = said, 128 + number


@dataclass
class Progress:
    """What a checkpoint holds beside the module and its optimizer.

    step: steps done.  rows: of the checks done.  losses: of the steps since the last check.
    drawn: state of torch's random numbers.
    """

    step: int = 0
    rows: list[Row] = field(default_factory=list)
    losses: list[Tensor] = field(default_factory=list)
    drawn: Tensor | None = None


class Loop:
    """Takes the steps that a module's settings say and checks it every `check_every` of them.

    save: keeps `state()` on disk; called after every check, every `SAVE_EVERY_S` seconds, and when
    the loop is stopped by Ctrl-C or SIGTERM; None keeps nothing.
    """

    def __init__(
        self,
        module: DenoisingModule,
        device: torch.device,
        *,
        label: str = "training",
        save: Callable[[], None] | None = None,
    ) -> None:
        self.module, self.device, self.label, self.save = module.to(device), device, label, save
        self.steps, self.check_every = module.settings.steps, module.settings.check_every
        self.progress = Progress()
        self.bar: Any = None
        self._asked = _Signals()
        # The same steps give the same weights, as far as the device has such kernels.
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
        torch.use_deterministic_algorithms(True, warn_only=True)
        self._optimizer = module.make_optimizer()

    def run(self, batches: Batches, check: Check) -> None:
        """Go on to the last step.

        Raises Stopped, FactoryError where the loss becomes no number, and what the calls raise.
        """
        done = self.progress
        self.bar = progress_bar(total=self.steps, initial=done.step, unit="step", desc=self.label)
        with self._asked, closing(self.bar):
            while len(done.rows) * self.check_every < self.steps:
                self._steps(batches, len(done.rows))
                loss = float(torch.stack(done.losses).mean())
                done.rows.append(check(done.step, loss))
                done.losses, done.drawn = [], None
                if self.save is not None:
                    self.save()

    def state(self) -> dict[str, Any]:
        """All that going on needs, in types that are loaded without running code."""
        done = self.progress
        return {
            "step": done.step,
            "losses": torch.stack(done.losses).cpu() if done.losses else torch.empty(0),
            "drawn": torch.get_rng_state() if done.losses else None,
            "module": self.module.state_dict(),
            "optimizer": self._optimizer.state_dict(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken; `rows` of it are those of the checks done then."""
        losses = list(state["losses"].to(self.device))
        self.progress = Progress(state["step"], list(state["rows"]), losses, state["drawn"])
        self.module.load_state_dict(state["module"])
        self._optimizer.load_state_dict(state["optimizer"])

    def moved(self, batch: Batch) -> Batch:
        """The batch on the device."""
        return {name: one.to(self.device, non_blocking=True) for name, one in batch.items()}

    def stop_if_asked(self) -> None:
        """Raise Stopped after Ctrl-C or SIGTERM, with what was done kept; also for long checks."""
        number = self._asked.number
        if not number:
            return
        if self.save is None:
            raise Stopped("interrupted; nothing was written", number)
        self.save()
        raise Stopped(
            f"interrupted after step {self.progress.step} of {self.steps}, which is kept; run "
            "again to go on",
            number,
        )

    def _steps(self, batches: Batches, interval: int) -> None:
        """The steps of an interval that are left."""
        done, end = self.progress, (interval + 1) * self.check_every
        if done.step == end:
            return
        saved_s = time.monotonic()
        self.module.train()
        number = int(stream(self.module.seed, "torch", interval).integers(2**62))
        if interval:
            torch.manual_seed(number)
        left = batches(interval, done.step - interval * self.check_every)
        if not interval:  # here the loader has drawn its own number before, elsewhere after
            torch.manual_seed(number)
        if done.drawn is not None:
            torch.set_rng_state(done.drawn)
        while done.step < end:
            try:
                batch = self.moved(next(left))
            except RuntimeError:
                # A reading process may have been stopped by the same Ctrl-C.
                self.stop_if_asked()
                raise
            self.module.step = done.step
            done.losses.append(self.module.update(self._optimizer, batch).detach())
            done.step += 1
            self.bar.update()
            self.stop_if_asked()
            if self.save is not None and time.monotonic() - saved_s > SAVE_EVERY_S:
                self.save()
                saved_s = time.monotonic()


class _Signals:
    """Notes Ctrl-C and SIGTERM; a second one ends the program at once."""

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _note(self, number: int, _: FrameType | None) -> None:
        if self.number:
            raise Stopped(
                "interrupted at once; the last checkpoint is kept, if there is one", number
            )
        self.number = number


def device_of(asked: str, key: str = "device=") -> torch.device:
    """The device that `auto`, `cpu` or `gpu` means here.  Raises FactoryError without a GPU."""
    has_gpu = torch.cuda.is_available()
    if asked == "gpu" and not has_gpu:
        raise FactoryError(f"{key}gpu: no usable GPU here; use {key}cpu")
    return torch.device("cuda" if has_gpu and asked != "cpu" else "cpu")


def precision_of(asked: str, device: torch.device) -> str:
    """`32-true` or `bf16-mixed`; says what `auto` became."""
    if asked != "auto":
        return asked
    chosen = "bf16-mixed" if has_bf16(device) else "32-true"
    print(f"train.precision=auto: {chosen}", file=sys.stderr, flush=True)
    return chosen


def has_bf16(device: torch.device) -> bool:
    """Whether the device has instructions for bfloat16; False where that is not known.

    Emulated it is slower than float32.
    """
    if device.type != "cpu":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    try:
        words = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split()
    except OSError:
        return False
    return "avx512_bf16" in words or "amx_bf16" in words
