"""Every command of README.md runs; the table says with what sizes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.project import readme_steps
from tests.project.readme_steps import Elsewhere, How, NotRun, Run, Step
from tests.project_files import ROOT

README = ROOT / "README.md"
STEPS = readme_steps.steps(README.read_text(encoding="utf-8")) if README.exists() else []

# README command -> how it is run here, in README order.  Later steps may use what earlier ones
# wrote: all run in one folder.
SMALL = (
    "scenes.locations=2",
    "scenes.frames_per_location=1",
    "scenes.width=484",
    "scenes.height=304",
)
TABLE: dict[str, How] = {
    "make demo": Run(
        (*SMALL, "scenes.frames_per_location=2", "dataset.dir={sandbox}/outputs/demo")
    ),
    "make test": Elsewhere(".ci/run", "make test"),
    ". .venv/bin/activate": NotRun("the tests run in that environment"),
    'pip install ".[blender,train]"': NotRun("the tests run in an environment that has all"),
    "simnfnd make experiment=simnfnd scenes.root=flsea-vi dataset.dir=outputs/flsea": Run(
        ("frames.limit=1",),
        instead=(("scenes.root=flsea-vi", "scenes.root={shared}/data/flsea-vi"),),
        needs="{shared}/data/flsea-vi",
    ),
    "simnfnd make -m noise.background.density=0.1,0.5 resample.rate=0.1,0.3 frames.total=6": Run(
        (*SMALL, "render=embree")
    ),
    "simnfnd make noise.range_spreading.alpha='{uniform: [0.01, 0.04]}' "
    "noise.azimuth.count=3 frames.total=6 dataset.dir=outputs/spread": Run(
        (*SMALL, "render=embree")
    ),
    "simnfnd make -m experiment=noise_sweep": Run((*SMALL, "render=embree")),
    "simnfnd make sonar=oculus_m750d_hf sonar.mount.translation_m='[0, 0, 0.5]' "
    "frames.total=6 dataset.dir=outputs/oculus": Run(SMALL),
    "simnfnd make sonar.image.layout=polar sonar.transfer.kind=log frames.total=6 "
    "dataset.dir=outputs/polar": Run((*SMALL, "render=embree")),
    "simnfnd make --help": Run(),
    "simnfnd preview outputs/demo --out outputs/sheet.png --pairs 4": Run(),
    "simnfnd inspect outputs/demo": Run(),
    "simnfnd export outputs/demo --to huggingface --out outputs/hub": Run(),
    "simnfnd train dataset=outputs/demo train.steps=200": Run(
        ("data.patch=64", "data.batch=2", "train.check_every=2"),
        instead=(("train.steps=200", "train.steps=4"),),
    ),
    "simnfnd denoise outputs/demo --out outputs/denoised": Run(),
    "simnfnd denoise dive.aris --out outputs/dive": Run(
        instead=(("dive.aris", "{shared}/data/aris-sdk/sample.aris"),),
        needs="{shared}/data/aris-sdk/sample.aris",
    ),
    "simnfnd denoise mdd/Images --out outputs/mdd --compare": Run(needs="{sandbox}/mdd"),
    "simnfnd geometry mdd/Images --out outputs/fans": Run(needs="{sandbox}/mdd"),
    "simnfnd denoise outputs/demo --out outputs/denoised-own "
    "--weights outputs/models/nafnet/weights.safetensors": Run(),
    "simnfnd evaluate dataset=outputs/demo": Run(),
    "simnfnd evaluate tune dataset=outputs/demo": Run(("tuning.pairs=2", "baselines=[median]")),
    "simnfnd evaluate dataset=outputs/demo baselines=[all] models=[outputs/models/nafnet]": Run(
        instead=(("baselines=[all]", "baselines=[median]"),)
    ),
    "simnfnd evaluate compare outputs/evaluation/demo-test outputs/evaluation/demo-test "
    "--row-b noisy": Run(),
    "simnfnd evaluate real mdd models=[simnfnd]": Run(
        ("workers=1", "baselines=[median]"), needs="{sandbox}/mdd"
    ),
    "simnfnd validate outputs/demo --deep": Run(),
}

TIMEOUT_S = 300.0


def test_readme_and_table_agree() -> None:
    assert README.exists(), "README.md is missing"
    assert STEPS, "README.md tells nobody how to start: no ```sh block"
    assert readme_steps.untold(STEPS, TABLE) == []


def test_readme_has_no_block_that_hides_commands() -> None:
    blocks = readme_steps.fences(README.read_text(encoding="utf-8"))
    assert {language for language, _, _ in blocks} <= readme_steps.LANGUAGES


def test_steps_run_elsewhere_really_are() -> None:
    for key, how in TABLE.items():
        if isinstance(how, Elsewhere):
            text = (ROOT / how.file).read_text(encoding="utf-8")
            assert how.text in text, f"`{key}`: {how.file} has no `{how.text}`"


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme")
    mdd = readme_steps.SHARED / "data" / "mdd"
    if mdd.is_dir():
        # Two of its pictures.
        for name in ("Images", "Masks"):
            (folder / "mdd" / name).mkdir(parents=True)
            for file in sorted((mdd / name).iterdir())[:2]:
                shutil.copy(file, folder / "mdd" / name)
        shutil.copy(mdd / "fan_geometry.csv", folder / "mdd")
    return folder


def how_to_run(step: Step) -> How:
    return TABLE.get(step.key, Run() if step.kind == "python" else NotRun("not in the table"))


# The others are answered for by the tests above, and are no test that passes here.
RUN_HERE = [(step, how) for step in STEPS if isinstance(how := how_to_run(step), Run)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "how"), RUN_HERE, ids=[f"line-{step.line}" for step, _ in RUN_HERE]
)
def test_step_runs(step: Step, how: Run, sandbox: Path) -> None:
    if lacking := readme_steps.missing(how, sandbox):
        pytest.skip(f"needs {lacking}")
    done = readme_steps.run(step, how, sandbox, TIMEOUT_S)
    assert done.returncode == 0, f"README.md:{step.line}: {step.text}\n{done.stdout[-4000:]}"


# The machinery above, on a text of our own.

SAMPLE = """# Title
```sh
make setup            # once
# a comment
echo one \\
    two
```
words
  ```python
  import sys

  print(sys.argv)
  ```
```text
not a command
```
```sh
cat there.txt
```
"""


def test_steps_are_found_in_order() -> None:
    found = readme_steps.steps(SAMPLE)
    assert [(step.kind, step.key, step.line) for step in found] == [
        ("sh", "make setup", 3),
        ("sh", "echo one two", 5),
        ("python", "import sys", 10),
        ("sh", "cat there.txt", 18),
    ]
    assert found[2].text == "import sys\n\nprint(sys.argv)"


@pytest.mark.parametrize(
    ("text", "said"),
    [("```sh\nls\n", "never closed"), ("```sh\nls \\\n```\n", "goes on after")],
)
def test_broken_blocks_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        readme_steps.steps(text)


def test_table_and_text_must_agree() -> None:
    found = readme_steps.steps(SAMPLE)
    table: dict[str, How] = {
        "make setup": Elsewhere(".ci/run", "make setup"),
        "echo one two": Run(),
        "gone": NotRun("an example"),
    }
    said = readme_steps.untold(found, table)
    assert len(said) == 2
    assert "README.md:18: `cat there.txt`" in said[0]
    assert "`gone`" in said[1]


def test_a_step_runs_in_the_sandbox(tmp_path: Path) -> None:
    write = Step("sh", "echo big > out.txt", 1)
    how = Run(instead=(("big", "small"),))
    assert readme_steps.run(write, how, tmp_path, 30).returncode == 0
    assert (tmp_path / "out.txt").read_text(encoding="utf-8") == "small\n"
    read = Step("python", "print(open('out.txt').read())", 2)
    assert "small" in readme_steps.run(read, Run(), tmp_path, 30).stdout


def test_a_failing_step_is_seen(tmp_path: Path) -> None:
    assert readme_steps.run(Step("sh", "false | cat", 1), Run(), tmp_path, 30).returncode == 1
    with pytest.raises(ValueError, match="which is not there"):
        readme_steps.command(Step("sh", "ls", 7), Run(instead=(("x", "y"),)), tmp_path)


def test_make_gets_its_arguments_and_this_environment(tmp_path: Path) -> None:
    words = readme_steps.command(
        Step("sh", "make demo", 1), Run(("dataset.dir={sandbox}/demo", "frames=2")), tmp_path
    )
    assert words[0] == "make"
    assert words[-1] == f"ARGS=dataset.dir={tmp_path}/demo frames=2"
    assert "demo" in words
    assert not any("pip" in word for word in words)


def test_what_a_step_needs(tmp_path: Path) -> None:
    assert readme_steps.missing(Run(needs="{sandbox}/no"), tmp_path) == f"{tmp_path}/no"
    assert readme_steps.missing(Run(needs="{root}/pyproject.toml"), tmp_path) is None
