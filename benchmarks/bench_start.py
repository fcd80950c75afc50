"""From Enter to answer: CPU time of short commands, beside what their libraries take to load.

Machines differ, and a machine differs from minute to minute, so every command takes turns with the
unit: Python that imports numpy, OpenCV and onnxruntime.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.shared import Options, Section, Table, run_command

TURNS = 5
UNIT = "import numpy, cv2, onnxruntime"
SHAPE = (320, 480)


def measure(options: Options) -> Section:
    """CPU seconds and units of each command, the best of some turns."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image = folder / "speckle.png"
        speckle = np.random.default_rng(0).rayleigh(40, SHAPE)
        cv2.imwrite(str(image), np.clip(speckle, 0, 255).astype(np.uint8))
        commands = {
            "`simnfnd denoise --help`": ["denoise", "--help"],
            "`simnfnd make --help`": ["make", "--help"],
            "one PNG of 480x320 through `denoise`": ["denoise", str(image)],
            "`simnfnd plan experiment=demo`": [
                "plan", "experiment=demo", f"cache.dir={folder}/cache",
            ],
        }  # fmt: skip
        first_plan = run_command(*commands["`simnfnd plan experiment=demo`"])
        unit_s = []
        command_s: dict[str, list[float]] = {label: [] for label in commands}
        for turn in range(options.amount(TURNS)):
            for label, words in commands.items():
                unit_s.append(_unit_s())
                out = ["--out", f"{folder}/{turn}"] if str(image) in words else []
                command_s[label].append(run_command(*words, *out).cpu)
    best_unit_s = min(unit_s)
    rows = [(label, min(times), min(times) / best_unit_s) for label, times in command_s.items()]
    rows.append(("the same, which measures once", first_plan.cpu, first_plan.cpu / best_unit_s))
    return Section((Table(("from Enter to answer", "CPU s", "units"), rows),))


def _unit_s() -> float:
    before = _children_s()
    subprocess.run([sys.executable, "-c", UNIT], check=True)
    return _children_s() - before


def _children_s() -> float:
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
