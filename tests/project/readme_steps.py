"""The commands of a page as data, and how a test runs them: small, and away from the checkout.

Every line of a ```sh block and every ```python block is a step.  Tables in
tests/project/test_readme.py and tests/project/page_tables.py say how each is run; a step that is
missing from the table of its page fails the tests.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from simnfnd.command import main
from tests.project_files import ROOT

SHARED = ROOT.parent / "shared"

# Commands hide from the table in any other kind of block.
LANGUAGES = frozenset({"sh", "python", "text", "yaml", "bibtex"})

_FENCE = re.compile(r"^\s*```+\s*(\S*)")
_COMMENT = re.compile(r"(^|\s+)#(\s.*|$)")
_TIME = re.compile(r"#\s.*?\b(\d+(?:\.\d+)?) (s|min)\b")


@dataclass(frozen=True)
class Step:
    """One thing the README tells the reader to run.

    kind: sh (one command, continuation lines joined) or python (a whole block).
    line: where it starts in the file, counted from 1.
    time_s: how long it takes, as the comment beside it says (`# 20 s`, `# 3 min`).
    page: the file, relative to the root.
    """

    kind: str
    text: str
    line: int
    time_s: float | None = None
    page: str = "README.md"

    @property
    def key(self) -> str:
        """What the table knows it by: the command, or the first line of the Python block."""
        return self.text.splitlines()[0]


@dataclass(frozen=True)
class Run:
    """Run the step in the sandbox, with what makes it small.

    extra: words added at the end of the command (handed to `make` as ARGS).
    instead: (old, new) replacements; `old` must be in the step.
    needs: a file or folder without which the step is skipped.
    {root}, {sandbox} and {shared} stand for the checkout, the folder the steps run in and the
    folder beside the checkout that holds real recordings.
    """

    extra: tuple[str, ...] = ()
    instead: tuple[tuple[str, str], ...] = ()
    needs: str | None = None


@dataclass(frozen=True)
class Elsewhere:
    """The step is run by something else: `file` of the checkout, which has to hold `text`."""

    file: str
    text: str


@dataclass(frozen=True)
class NotRun:
    """The step cannot run in a test; `why` says so (a download, a cluster, a question)."""

    why: str


How = Run | Elsewhere | NotRun


def fences(markdown: str) -> list[tuple[str, int, list[str]]]:
    """(language, first line number, lines) of every fenced block; ValueError for an open one."""
    blocks: list[tuple[str, int, list[str]]] = []
    inside = False
    for number, line in enumerate(markdown.splitlines(), start=1):
        match = _FENCE.match(line)
        if match and not inside:
            blocks.append((match.group(1), number + 1, []))
        elif inside and not match:
            blocks[-1][2].append(line)
        inside = inside != bool(match)
    if inside:
        raise ValueError(f"line {blocks[-1][1] - 1}: the block is never closed")
    return blocks


def steps(markdown: str, page: str = "README.md") -> list[Step]:
    """Everything to run, in the order of reading."""
    found: list[Step] = []
    for language, first, lines in fences(markdown):
        if language == "python":
            found.append(Step("python", textwrap.dedent("\n".join(lines)), first, page=page))
        elif language == "sh":
            found += _commands(lines, first, page)
    return found


def _commands(lines: list[str], first: int, page: str) -> list[Step]:
    found: list[Step] = []
    waiting = ""
    start = first
    time_s: float | None = None
    for number, line in enumerate(lines, start=first):
        text = line.strip() if waiting else _COMMENT.sub("", line).strip()
        start = start if waiting else number
        if said := _TIME.search(line):
            time_s = float(said.group(1)) * {"s": 1, "min": 60}[said.group(2)]
        waiting = f"{waiting} {text.removesuffix(chr(92)).strip()}".strip()
        if text.endswith("\\"):
            continue
        if waiting:
            found.append(Step("sh", waiting, start, time_s, page))
            time_s = None
        waiting = ""
    if waiting:
        raise ValueError(f"line {start}: the command goes on after the block's end")
    return found


def untold(found: list[Step], table: Mapping[str, How]) -> list[str]:
    """What the table and the page do not agree on, as sentences."""
    keys = {step.key for step in found}
    return [
        f"{step.page}:{step.line}: `{step.key}` is not in the table of tests/project"
        for step in found
        if step.kind == "sh" and step.key not in table
    ] + [f"the table names `{key}`, which the page has not" for key in table if key not in keys]


def _filled(text: str, sandbox: Path) -> str:
    places = {"{root}": ROOT, "{sandbox}": sandbox, "{shared}": SHARED}
    for name, path in places.items():
        text = text.replace(name, str(path))
    return text


def missing(how: Run, sandbox: Path) -> str | None:
    """The path that the step needs and this machine has not, or None."""
    if how.needs is None:
        return None
    path = _filled(how.needs, sandbox)
    return None if Path(path).exists() else path


def _text(step: Step, how: Run, sandbox: Path) -> str:
    text = step.text
    for old, new in how.instead:
        if old not in text:
            raise ValueError(
                f"{step.page}:{step.line}: the table replaces `{old}`, which is not there"
            )
        text = text.replace(old, new)
    return _filled(text, sandbox)


def here(step: Step, how: Run, sandbox: Path) -> int:
    """Run `step` in this process, with `sandbox` as working directory; returns its exit code.

    Nothing has to be started and imported, which takes most of the time of a small command.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(sandbox)
        text = _text(step, how, sandbox)
        if step.kind == "python":
            exec(compile(text, step.page, "exec"), {"__name__": "__main__"})
            return 0
        program, *words = [*shlex.split(text), *(_filled(word, sandbox) for word in how.extra)]
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


def command(step: Step, how: Run, sandbox: Path) -> list[str]:
    """The argument vector that runs `step` as `how` says.  ValueError when they do not fit."""
    text = _text(step, how, sandbox)
    extra = _filled(" ".join(how.extra), sandbox)
    if step.kind == "python":
        return [sys.executable, "-c", text]
    if text.startswith("make "):
        # The environment that runs this test is the one to use: -o keeps make from renewing it.
        prefix = Path(sys.prefix)
        target = text.removeprefix("make ").split()
        stamps = [prefix / f".simnfnd-{name}" for name in ("core", "installed")]
        return [
            "make",
            "-C",
            str(ROOT),
            *(word for stamp in stamps for word in ("-o", str(stamp))),
            *target,
            f"VENV={prefix}",
            f"ARGS={extra}",
        ]
    return ["bash", "-euo", "pipefail", "-c", f"{text} {extra}".strip()]


def run(step: Step, how: Run, sandbox: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """Run `step` with `sandbox` as working directory; output and errors come back as one text."""
    environment = dict(os.environ)
    # `python` and the console scripts are those of the interpreter that runs this test.
    environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), environment["PATH"]])
    environment["PYTHONPATH"] = str(ROOT)
    return subprocess.run(
        command(step, how, sandbox),
        cwd=sandbox,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=timeout_s,
        check=False,
    )
