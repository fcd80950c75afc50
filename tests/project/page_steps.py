"""The commands of README.md, the tutorials and the how-to pages: as data, made small, and run.

Every line of a ```sh block and every ```python block is a step.  Blocks of ```bash and ```py are
not: they need files, machines or hours that a test does not have.
"""

from __future__ import annotations

import re
import runpy
import shlex
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import pytest

from simnfnd.command import main
from tests.project_files import ROOT

# README.md first: others use the dataset that it makes.
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs/tutorials").glob("*.md")),
    *sorted((ROOT / "docs/how-to").glob("*.md")),
]
# tests/project/test_extending.py runs it, in an environment of its own.
PAGES.remove(ROOT / "docs/how-to/extending.md")

_FENCE = re.compile(r"^ *```+ *(\S*)\n(.*?)^ *```+ *$", re.MULTILINE | re.DOTALL)
_COMMENT = re.compile(r"(^|\s+)#(\s.*|$)")
_TIME = re.compile(r"#\s.*?\b(\d+(?:\.\d+)?) (s|min)\b")

# What a command gets at its end to be small: the words of the first entry that it holds.
SMALL_SEABED = (
    "scenes.locations=2", "scenes.frames_per_location=1", "scenes.width=242", "scenes.height=152",
)  # fmt: skip
_ALONE = ("scheduler=serial",)
_FEW = ("workers=1", "baselines=[median]")
_SMALL = {
    "--help": (),
    "scenes=csv_list": _ALONE,
    "scenes=mesh": (*SMALL_SEABED[2:], *_ALONE),
    "scenes.root=flsea-vi": (*_ALONE, "frames.limit=1"),
    "+scenes/objects": (
        *SMALL_SEABED[:2], "scenes.width=484", "scenes.height=304", "frames.variants=1", *_ALONE,
    ),
    "experiment=fish": (
        *SMALL_SEABED[:1], "scenes.frames_per_location=2", *SMALL_SEABED[2:], *_ALONE,
        "sonar.image.width_px=192", "sonar.image.height_px=192",
    ),
    "experiment=noise_sweep": (*SMALL_SEABED, *_ALONE, "render=embree", "resample.rate=0.3"),
    "render=": (*SMALL_SEABED, *_ALONE),
    "simnfnd make": (*SMALL_SEABED, *_ALONE, "render=embree"),
    "simnfnd train": ("train.steps=4", "train.check_every=2", "data.patch=64", "data.batch=2"),
    "evaluate tune": (*_FEW, "tuning.pairs=2"),
    "evaluate dataset": (*_FEW, "limit=2", "bootstrap=100"),
    "evaluate real": _FEW,
}  # fmt: skip


@dataclass(frozen=True)
class Step:
    """One thing that a page tells its reader to run.

    kind: sh (one command, continuation lines joined) or python (a whole block).
    line: where it starts in the file, counted from 1.
    time_s: how long it takes, as the comment beside it says (`# 20 s`, `# 3 min`).
    """

    kind: str
    text: str
    page: Path
    line: int
    time_s: float | None = None

    def small(self) -> tuple[str, ...]:
        """The words that make the command small."""
        return next((words for part, words in _SMALL.items() if part in self.text), ())


def fences(page: Path) -> list[tuple[str, int, list[str]]]:
    """(language, first line number, lines) of every fenced block."""
    text = page.read_text(encoding="utf-8")
    return [
        (block[1], text.count("\n", 0, block.start(2)) + 1, block[2].splitlines())
        for block in _FENCE.finditer(text)
    ]


def steps(page: Path) -> list[Step]:
    """Everything to run, in the order of reading."""
    actual: list[Step] = []
    for language, first, lines in fences(page):
        if language == "python":
            actual.append(Step("python", textwrap.dedent("\n".join(lines)), page, first))
        elif language == "sh":
            actual += _commands(lines, first, page)
    return actual


def _commands(lines: list[str], first: int, page: Path) -> list[Step]:
    actual: list[Step] = []
    waiting = ""
    for number, line in enumerate(lines, start=first):
        text = _COMMENT.sub("", line).strip()
        waiting = f"{waiting} {text.removesuffix(chr(92)).strip()}".strip()
        if waiting and not text.endswith("\\"):
            said = _TIME.search(line)
            time_s = float(said[1]) * {"s": 1, "min": 60}[said[2]] if said else None
            actual.append(Step("sh", waiting, page, number, time_s))
            waiting = ""
    return actual


def run(step: Step, folder: Path) -> int:
    """Run `step`, made small, in this process and in `folder`; returns its exit code.

    Nothing has to be started and imported, which is most of the time of a small command.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        if step.kind == "python":
            exec(compile(step.text, str(step.page), "exec"), {"__name__": "__main__"})
            return 0
        program, *words = [*shlex.split(step.text), *step.small()]
        try:
            if program == "python":
                patch.setattr(sys, "argv", words)
                runpy.run_path(words[0], run_name="__main__")
                return 0
            assert program == "simnfnd", f"{step.page}:{step.line}: {program} is none of ours"
            patch.setattr(sys, "argv", ["simnfnd"])  # Hydra's words are put there
            return main(words)
        except SystemExit as ended:
            return int(ended.code or 0)
