"""`simnfnd`: what it lists, and how it answers mistakes and modules that are not installed."""

from __future__ import annotations

import os
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest

import simnfnd
from simnfnd.command import main, overview
from simnfnd.factory.common.extras import EXTRAS
from simnfnd.verbs import VERBS
from tests.fake_source import FakeConfig
from tests.project_files import ROOT, project
from tests.run_fake import make


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Exit code of `simnfnd WORDS`, in this process."""
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    try:
        return main(words)
    except SystemExit as ended:  # argparse, after its help
        return int(ended.code or 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", VERBS)
def test_every_verb_is_listed_and_explains_itself(name: str, monkeypatch, capsys) -> None:
    verb = VERBS[name]
    assert f"\n  {name} " in overview()
    assert any(f"simnfnd {name}" in example for example in verb.examples)
    assert set(verb.needs) <= set(EXTRAS)
    assert run(monkeypatch, *name.split(), "--help") == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"simnfnd {name}: {verb.line}\n\nExamples:\n  simnfnd ")
    parts = ("keys (key=value)",) if verb.config else ("usage: simnfnd",)
    assert any(part in printed.lower() for part in parts)


@pytest.mark.slow
def test_a_verb_lists_the_verbs_of_its_own(monkeypatch, capsys) -> None:
    assert run(monkeypatch, "evaluate", "--help") == 0
    printed = capsys.readouterr().out
    for name, verb in VERBS.items():
        if name.startswith("evaluate "):
            assert f"\n  {name:<17} {verb.line}" in printed


def test_help_imports_the_standard_library_alone() -> None:
    code = (
        "import sys; before = set(sys.modules)\n"
        "from simnfnd.command import main; main(['--help'])\n"
        "tops = {name.split('.')[0] for name in set(sys.modules) - before}\n"
        "assert tops <= {*sys.stdlib_module_names, 'simnfnd'}, tops - sys.stdlib_module_names\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_the_overview_and_the_version(monkeypatch, capsys) -> None:
    for words, said in (
        (("help",), overview()),
        (("make", "--version"), f"simnfnd {simnfnd.__version__}"),
    ):
        assert run(monkeypatch, *words) == 0
        assert capsys.readouterr().out == f"{said}\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("mkae",), "mkae: no such verb; did you mean `simnfnd make`"),
        (("tune", "dataset=x"), "did you mean `simnfnd evaluate tune`?"),
        (("cache", "sats"), "invalid choice: 'sats' (choose from"),
        (("evaluate", "outputs/demo"), "did you mean `simnfnd evaluate dataset=outputs/demo`?"),
        (("evaluate", "qqqqq"), "qqqqq: no such verb; `simnfnd evaluate --help` lists them"),
        (("seed=3",), "seed=3: a setting needs a verb before it; did you mean `simnfnd make"),
        (("make", "demo"), "demo: not KEY=VALUE; see `--help`"),
        (("train", "sed=1"), "sed"),
        (("export", "x"), "--to, --out (see `simnfnd export --help`)"),
        (("status", "x", "--faled"), "unrecognized arguments: --faled"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line_and_exit_code_two(words, said: str, monkeypatch, capsys) -> None:
    assert run(monkeypatch, *words) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert said in error
    assert len(error) < 400


def test_a_stale_index_has_a_remedy_that_works(monkeypatch, tmp_path: Path, capsys) -> None:
    dataset = tmp_path / "data"
    make(dataset, FakeConfig(), scheduler={"backend": "serial"})
    with h5py.File(dataset / "index.h5", "r+") as index:
        del index["test"]
    assert run(monkeypatch, "validate", str(dataset)) == 1
    assert "run the command that made the dataset again" in capsys.readouterr().out
    (dataset / "index.h5").unlink()
    make(dataset, FakeConfig(), scheduler={"backend": "serial"})
    assert run(monkeypatch, "validate", str(dataset)) == 0
    out = str(dataset / "manifest.json/sheet.png")
    assert run(monkeypatch, "preview", str(dataset), "--out", out) == 2
    assert "\nerror: --out: cannot write " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("number", "code", "kept"),
    [(signal.SIGINT, 130, ""), (signal.SIGTERM, 143, "12 of 40 files are done")],
)
def test_every_verb_stops_alike(number: int, code: int, kept: str, monkeypatch, capsys) -> None:
    from simnfnd.factory.production.commands import status

    def work(words: list[str]) -> None:
        try:
            os.kill(os.getpid(), number)
            time.sleep(20)
        except KeyboardInterrupt as stopped:
            if kept:
                stopped.kept = kept  # type: ignore[attr-defined]
            raise

    monkeypatch.setattr(status, "main", work)
    assert run(monkeypatch, "status", "x") == code
    said = f"interrupted; {kept}" if kept else "interrupted"
    assert capsys.readouterr().err == f"error: {said}\n"


# --- modules that are not installed -------------------------------------------------------------


def test_all_that_is_absent_is_said_at_once(monkeypatch, tmp_path: Path, capsys) -> None:
    for module in ("bpy", "distributed"):
        monkeypatch.setitem(sys.modules, module, None)
    assert run(monkeypatch, "demo", "scheduler=dask", f"dataset.dir={tmp_path / 'out'}") == 2
    assert capsys.readouterr().err == (
        "error: render=cycles needs bpy, scheduler=dask needs distributed: "
        'pip install "simnfnd[blender,cluster]", or choose render=analytic or render=embree; '
        "scheduler=local\n"
    )


@pytest.mark.slow
def test_help_and_configuration_need_nothing(monkeypatch, capsys) -> None:
    for module in EXTRAS:
        monkeypatch.setitem(sys.modules, module, None)
    for words in (("train", "--cfg", "job"), ("evaluate", "fit", "--help")):
        assert run(monkeypatch, *words) == 0
    assert 'Needs pip install "simnfnd[' in capsys.readouterr().out


def test_the_extras_install_what_they_are_named_for() -> None:
    declared = project()["project"]["optional-dependencies"]
    distributions = {"skimage": "scikit-image", "open3d": "open3d-cpu", "cv2": "opencv-python"}
    for module, extra in EXTRAS.items():
        lines = " ".join(declared[extra])
        assert distributions.get(module, module) in lines
    everything = set(declared) - {"all", "dev", "docs"}
    assert declared["all"] == [f"simnfnd[{','.join(k for k in declared if k in everything)}]"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("room", "verb"), [("factory", "make"), ("models", "train"), ("evaluation", "evaluate")]
)
def test_a_room_of_the_checkout_runs_its_verb(
    room: str, verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [room, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / room / "__main__.py"), run_name="__main__")
    assert not ended.value.code
    assert capsys.readouterr().out.startswith(f"simnfnd {verb}: ")


@pytest.mark.slow
def test_the_core_alone_answers_every_verb(tmp_path: Path) -> None:
    """Without any extra: help of all verbs, a dataset and what looks at it, one line of the rest.

    In one process of its own, for modules that are loaded already would be found.
    """
    words = [sys.executable, "-c", _CORE_ALONE]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "core alone: 0 defects" in done.stdout


_CORE_ALONE = r"""
import contextlib, io, pathlib, sys
from simnfnd.factory.common.extras import EXTRAS
for module in EXTRAS:
    sys.modules[module] = None
from simnfnd.command import main
from simnfnd.verbs import VERBS

defects = 0

def said(line, code, part=""):
    global defects
    out, err = io.StringIO(), io.StringIO()
    sys.argv = ["simnfnd"]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            found = main(line.split())
    except SystemExit as ended:
        found = ended.code or 0
    text = out.getvalue() + err.getvalue()
    if found != code or part not in text or (code == 2 and err.getvalue().count("\n") != 1):
        defects += 1
        print(f"simnfnd {line}: exit code {found}, {text}")
    return text

for name in (name for name, verb in VERBS.items() if not verb.config):
    said(f"{name} --help", 0)
small = "scenes.locations=2 scenes.frames_per_location=1 scenes.width=242 scenes.height=152"
made = f"render=analytic experiment=demo {small} scheduler=serial cache.dir=cache dataset.dir=made"
said(f"plan {made}", 0)
said(f"make {made}", 0, "dataset: made")
said("status made", 0)
said("status made --failed", 0)
said("validate made --deep", 0)
said("inspect made", 0, "SSIM")
said("preview made --out sheet.png", 0)
said("cache stats cache.dir=cache", 0, "2 renders")
said(f"cache pack {made} --out views.pack", 0, "2 frames")
said("cache clear cache.dir=cache", 0)
said(f"demo {made.replace('made', 'again')} scenes.first_location=9", 0)
said("merge made again --out both", 0)
points = f"render=analytic {small} scheduler=serial cache.dir=cache dataset.dir=points"
said(f"demo {points}", 0, 'pip install "simnfnd[sonar]"')
open("film.avi", "wb").close()
said("preview film.avi --out x.png", 2, 'film.avi needs cv2: pip install "simnfnd[sonar]"')
said("view .", 2, 'needs cv2: pip install "simnfnd[sonar]"')
said(f"make {made} experiment=physical", 2, 'pip install "simnfnd[sonar]"')
said(f"make {made.replace('serial', 'dask')} dataset.dir=x", 2, 'pip install "simnfnd[cluster]"')
said("export made --to png --out x", 2, 'needs cv2: pip install "simnfnd[sonar]"')
said("export made --to huggingface --out x", 2, 'pip install "simnfnd[export,sonar]"')
for words in ("train dataset=made", "denoise made --out x",
              "adapt made --out x", "export-weights simnfnd --out x", "evaluate dataset=made",
              "evaluate tune dataset=made", "evaluate compare a b", "evaluate real a",
              "evaluate targets a", "evaluate transfer a b", "detect made --out x",
              "evaluate realism a b", "evaluate fit a"):
    said(words, 2, "pip install")
said("make render=cycles dataset.dir=x", 2, "needs bpy")
assert not pathlib.Path("x").exists(), "said before any work"
print(f"core alone: {defects} defects")
"""


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error_of_ours() -> None:
    """As with `simnfnd make --help | head -1`."""
    command = [sys.executable, "-m", "simnfnd", "cache", "stats"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdout.close()
        said = running.stderr.read()
        assert running.wait() == 128 + signal.SIGPIPE
    assert said == b""
