"""Running the steps of a campaign: what is done stays done, what fails does not stop the rest."""

from __future__ import annotations

import fnmatch
import json
import shlex
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path
from typing import Any

from ...factory.errors import FactoryError
from ...factory.files import check_writable, sha256_of, write_atomically
from ...factory.scheduler.lock import Lock
from ...factory.scheduler.workers.signals import Interrupted, stop_signals
from ...models import WEIGHTS_NAME
from .plan import (
    Folders,
    Step,
    data_steps,
    report_steps,
    training_name,
    training_steps,
)
from .processes import Processes, Programs
from .settings import CampaignSettings, RowSettings
from .trainings import write_trainings

_CLEAR_CPU_S, _CLEAR = 4.0, 0.3
_SOME_FAILED = 1
"""Exit code of a command that did its work, but for some frames or files."""


class Campaign:
    """One campaign in its folder.  run: how commands are run; as processes unless given.

    failed: names of the steps that failed, in the order of the plan.
    """

    def __init__(self, settings: CampaignSettings, run: Programs | None = None) -> None:
        self.settings, self._run = settings, run or Processes()
        self.folders = Folders(Path(settings.out))
        self.failed: list[str] = []
        self._ending = threading.Event()
        self._measuring = {row.name: threading.Lock() for row in settings.rows}

    def __call__(self) -> int:
        """Do what is left of it; 1 when a step failed, and the others were done.

        Raises FactoryError when another campaign is at work in the folder, and KeyboardInterrupt
        when it or one of its commands was interrupted; then none of them runs any more.
        """
        check_writable(self.folders.out, "out")
        with ExitStack() as stack:
            stack.enter_context(stop_signals())
            try:
                stack.enter_context(Lock(self.folders.out))
            except FactoryError as error:
                raise FactoryError(
                    f"out={self.folders.out}: another campaign is at work there; wait for it, or "
                    "give another out="
                ) from error
            return self._do()

    def _do(self) -> int:
        self._do_all([*data_steps(self.settings), *training_steps(self.settings)])
        trained = self.trained()
        if trained:
            write_trainings(self.folders, trained)
            self._do_all(list(report_steps(self.settings, self._weights(trained))))
        if self.failed:
            print(f"campaign: failed: {', '.join(self.failed)}; run again to try them again")
        print(f"campaign: {self.folders.out}")
        return 1 if self.failed else 0

    def show(self) -> None:
        """Print what is planned, and what is done."""
        steps = [*data_steps(self.settings), *training_steps(self.settings)]
        steps += report_steps(self.settings, self._weights(self.trained()))
        for step in steps:
            state = "done" if self._record(step.name).get("code") == 0 else "to do"
            print(f"{state:5}  {step.name}: simnfnd {step.verb} {shlex.join(step.words)}")

    def trained(self) -> list[tuple[str, int]]:
        """(row, seed) of the trainings that are finished, in the order of the plan."""
        return [
            (row.name, seed)
            for row in self.settings.rows
            for seed in row.seeds
            if self._record(training_name(row.name, seed)).get("code") == 0
            and (self.folders.model(row.name, seed) / WEIGHTS_NAME).is_file()
        ]

    def _weights(self, trained: Sequence[tuple[str, int]]) -> list[str]:
        """The folders that hold their weights."""
        return [str(self.folders.model(row, seed)) for row, seed in trained]

    def _do_all(self, steps: Sequence[Step]) -> None:
        patterns = self.settings.only
        chosen = [
            (f"{number}/{len(steps)}", step)
            for number, step in enumerate(steps, start=1)
            if not patterns or any(fnmatch.fnmatch(step.name, one) for one in patterns)
        ]
        # What begins from weights of another training waits for all trainings before it.
        for depth, group in groupby(chosen, key=lambda one: self._together(one[1])):
            self._do_group(list(group), 1 if depth is None else self.settings.jobs)

    def _together(self, step: Step) -> int | None:
        """Trainings in a row for which this is the same need nothing of each other."""
        return None if step.row is None else self.settings.depth(step.row)

    def _do_group(self, group: Sequence[tuple[str, Step]], jobs: int) -> None:
        """Steps that need nothing of each other, or one job after another, begun in order."""
        with ThreadPoolExecutor(jobs) as pool:
            try:
                begun = [pool.submit(self._begin, number, step) for number, step in group]
                for one in as_completed(begun):
                    one.result()
            except BaseException as error:
                self._ending.set()
                pool.shutdown(wait=False, cancel_futures=True)
                # A terminal sends Ctrl-C to the commands, too.
                ctrl_c = isinstance(error, Interrupted) and error.exit_code == 128 + signal.SIGINT
                self._run.stop(signalled=ctrl_c)
                raise
        self.failed += [
            step.name for (_, step), one in zip(group, begun, strict=True) if not one.result()
        ]

    def _begin(self, number: str, step: Step) -> bool:
        """`_do_step`, which when it raises ends the campaign; nothing is begun from then on."""
        if self._ending.is_set():
            return False
        try:
            return self._do_step(number, step)
        except BaseException:
            # Set here: this thread would take its next step before the main one learns of it.
            self._ending.set()
            raise

    def _do_step(self, number: str, step: Step) -> bool:
        """Do a step unless it is done; False when it failed.  number: of the step and of all."""
        try:
            words = (*step.words, *self._length(step))
        except FactoryError as error:
            _log(f"{step.name}: {error}", error=True)
            return False
        asked = {"words": list(words), "inputs": self._inputs(step)}
        record = self._record(step.name)
        if record.get("code") == 0 and {name: record.get(name) for name in asked} == asked:
            return True
        _log(f"{number} {step.name}")
        # A finished training with other words, or from other weights, starts afresh.
        afresh = ("resume=false",) if step.row is not None and record.get("code") == 0 else ()
        code, cpu_s, wall_s = self._timed(step.verb, (*words, *afresh))
        if step.verb in ("make", "cache") and code == _SOME_FAILED:
            # `simnfnd make` lists the frames that cannot be used; the dataset is there.
            code = 0
        self._keep(step.name, {**asked, "code": code, "cpu_s": cpu_s, "wall_s": wall_s})
        if code > 128 or code < 0:
            raise KeyboardInterrupt
        return code == 0

    def _length(self, step: Step) -> tuple[str, ...]:
        """How long a training is: as many steps as its budget pays for, in equal intervals."""
        if step.row is None:
            return ()
        if step.row.steps is not None:
            return self._steps(step.row, step.row.steps)
        assert step.row.cpu_s is not None
        # Another seed of the row waits for what the first one measures.
        with self._measuring[step.row.name]:
            pace = self._pace(step)
        return self._steps(step.row, int(step.row.cpu_s / pace))

    def _steps(self, row: RowSettings, steps: int) -> tuple[str, ...]:
        checks = row.checks or self.settings.checks
        every = steps // checks
        if every < 1:
            raise FactoryError(
                f"rows: {row.name}: its length is {steps} steps, and {checks} "
                "validations need one each; give it more"
            )
        return f"train.steps={every * checks}", f"train.check_every={every}"

    def _pace(self, step: Step) -> float:
        """CPU seconds of one step: measured once a row, then kept, so that resuming is exact."""
        assert step.row is not None
        name = f"pace-{step.row.name}"
        known = self._record(name)
        if "cpu_s_per_step" in known:
            return float(known["cpu_s_per_step"])
        base = self._short(step, 1)
        count = self.settings.pace_steps
        # Starting and ending costs more than a few steps and varies: only a clear rise counts.
        while (rise := self._short(step, 1 + count) - base) < max(_CLEAR_CPU_S, _CLEAR * base):
            count *= 2
        pace = rise / (5 * count)
        self._keep(name, {"cpu_s_per_step": pace, "words": list(step.words)})
        return pace

    def _short(self, step: Step, every: int) -> float:
        """CPU seconds of a training of five intervals of so many steps."""
        assert step.row is not None
        words = (
            *step.words,
            *(f"out='{self.folders.out / 'pace' / step.row.name}'", "resume=false"),
            *("data.validation_limit=1", "tensorboard=false", "pictures=0"),
            *(f"train.steps={5 * every}", f"train.check_every={every}"),
        )
        code, cpu_s, _ = self._timed(step.verb, words)
        if code > 128 or code < 0:
            raise KeyboardInterrupt
        if code:
            raise FactoryError(f"rows: {step.row.name} cannot be trained, see above")
        return cpu_s

    def _timed(self, verb: str, words: Sequence[str]) -> tuple[int, float, float]:
        """(exit code, CPU seconds of the command and its workers, seconds)."""
        if self._ending.is_set():
            raise KeyboardInterrupt
        start = time.monotonic()
        code, cpu_s = self._run(verb, words, self.settings.threads)
        return code, round(cpu_s, 2), round(time.monotonic() - start, 1)

    def _inputs(self, step: Step) -> dict[str, str]:
        """What a step depends on beside its words.

        Trainings on the weights from which they go on, reports on weights, the table on reports.
        """
        files: list[Path] = []
        if step.start is not None and step.start.is_file():
            files = [step.start]
        elif step.name.startswith(("report-", "table")):
            files = [Path(folder) / WEIGHTS_NAME for folder in self._weights(self.trained())]
        if step.name == "table":
            files += sorted(self.folders.out.glob("reports/*/results.parquet"))
        return {str(file.relative_to(self.folders.out)): sha256_of(file)[:16] for file in files}

    def _record(self, name: str) -> dict[str, Any]:
        try:
            content: dict[str, Any] = json.loads(self._path(name).read_text(encoding="utf-8"))
            return content
        except (OSError, ValueError):
            return {}

    def _keep(self, name: str, content: Mapping[str, Any]) -> None:
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, (json.dumps(content, indent=1) + "\n").encode(), key="out")

    def _path(self, name: str) -> Path:
        return self.folders.out / "steps" / f"{name}.json"


def _log(text: str, *, error: bool = False) -> None:
    """Print a line in one piece, whatever other threads print."""
    print(f"campaign: {text}\n", end="", file=sys.stderr if error else sys.stdout, flush=True)
