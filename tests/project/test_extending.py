"""A package outside of the repository adds an effect, a reader, a method and presets.

It is written from the code of docs/how-to/extending.md, which thereby runs.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra.core.config_store import ConfigStore

import simnfnd
from simnfnd.command import main
from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.metrics import own
from simnfnd.extensions import (
    FactoryError,
    OwnMetric,
    register_effect,
    register_method,
    register_metric,
    register_reader,
)
from simnfnd.factory.common import extensions
from simnfnd.factory.simulation.noise import registry
from simnfnd.factory.simulation.noise.registry import EFFECTS
from tests.project.test_face import PLACE, frame
from tests.project_files import ROOT

PAGE = (ROOT / "docs/how-to/extending.md").read_text(encoding="utf-8")
FAST = (
    "render=analytic", "scenes.locations=2", "scenes.frames_per_location=2", "scenes.width=160",
    "scenes.height=100", "scheduler.workers=2", "dataset.preview_pairs=0",
)  # fmt: skip


def write_package(site: Path) -> None:
    """The package `mine` as pip installs it: its files, and metadata with its entry points."""
    for block in re.findall(r"```(?:python|yaml)\n# (mine/\S+)\n(.*?)```", PAGE, re.DOTALL):
        path = site / block[0]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"# {block[0]}\n{block[1]}")
    for folder in ("mine", "mine/presets"):
        (site / folder / "__init__.py").write_text("")
    groups = tomllib.loads(PAGE.split("```toml\n")[1].split("```")[0])["project"]["entry-points"]
    metadata = site / "mine_extensions-1.5.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: mine-extensions\nVersion: 1.5\n"
    )
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{name} = {target}" for name, target in points.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    site = tmp_path_factory.mktemp("site")
    write_package(site)
    return site


def run_python(site: Path, cwd: Path, code: str, *words: str) -> str:
    """What `python -c CODE WORDS` prints on stdout and stderr where the package is installed."""
    path = os.pathsep.join([str(site), *map(os.path.abspath, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=cwd, env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
    return done.stdout


@contextmanager
def installed(site: Path) -> Iterator[None]:
    """Within the block this process has the package; nothing of it stays."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        extensions._entry_points.cache_clear()
        try:
            yield
        finally:
            for kind, name in list(extensions._registered):
                extensions._registered.pop((kind, name))
            REGISTRY.pop("row_median", None)
            registry._problem_of.cache_clear()
            EFFECTS.pop("drifting_snow", None)
            ConfigStore.instance().repo.get("scenes", {}).pop("npz_folder.yaml", None)
            for module in [name for name in sys.modules if name.split(".")[0] == "mine"]:
                sys.modules.pop(module)
    extensions._entry_points.cache_clear()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd) -> Callable[..., str]:
    """Runs `simnfnd WORDS` in `tmp_path` and in this process; returns what it prints."""
    monkeypatch.chdir(tmp_path)

    def run_command(site: Path, *words: str, code: int = 0) -> str:
        monkeypatch.setattr(sys, "argv", ["simnfnd"])
        with installed(site):
            try:
                actual_code = main(words)
            except SystemExit as stopped:
                actual_code = int(stopped.code or 0)
        printed = "".join(capfd.readouterr())
        assert actual_code == code, printed[-3000:]
        return printed

    return run_command


SNOWY = ("make", "experiment=demo", *FAST, "dataset.dir=data", "noise.drifting_snow.density=0.1")
DIVES = (
    "make", "scenes=npz_folder", "scenes.root=dives", "scenes.intrinsics=[120,120,76,48]",
    "sonar=mine_hf", "render=analytic", "scheduler.workers=2", "dataset.preview_pairs=0",
    "dataset.dir=dived", "split.test=[two]",
)  # fmt: skip
# Each command ends with a line of its exit code.
MAKE_BOTH = """
import json, sys
from simnfnd.command import main

for words in json.loads(sys.argv.pop()):
    sys.argv = ["simnfnd"]
    code = main(words)
    sys.stderr.flush()
    print(f"exit code {int(code or 0)}", flush=True)
"""


@pytest.fixture(scope="module")
def made(site: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with two datasets, made by worker processes, and what their commands printed.

    `data` has the package's effect; `dived` comes from its reader and preset.
    """
    folder = tmp_path_factory.mktemp("made")
    rgb, depth_m = frame()
    for scene in ("one", "two"):
        (folder / "dives" / scene).mkdir(parents=True)
        for number in range(2):
            scaled_m = np.nan_to_num(depth_m) * (1 + 0.1 * number)
            np.savez(folder / f"dives/{scene}/{number}.npz", rgb=rgb, depth_m=scaled_m)
    (folder / "dives/two/bad.npz").write_bytes(b"x")
    return folder, run_python(site, folder, MAKE_BOTH, json.dumps([SNOWY, DIVES]))


@pytest.mark.slow
def test_the_manifest_names_the_package_of_an_effect(made: tuple[Path, str]) -> None:
    folder, printed = made
    assert "exit code 0" in printed.splitlines()
    manifest = json.loads((folder / "data/manifest.json").read_text())
    (stated,) = manifest["config"]["extensions"]
    assert (stated["kind"], stated["name"]) == ("effect", "drifting_snow")
    assert (stated["package"], stated["version"]) == ("mine-extensions", "1.5")
    assert manifest["config"]["noise"]["drifting_snow"]["enabled"] is True
    with simnfnd.PairDataset(folder / "data", "all") as pairs:
        table = pairs.meta()
    assert set(table["noise.drifting_snow.density"]) == {0.1}
    assert (table["points.drifting_snow"] > 0).all()


@pytest.mark.slow
def test_resuming_knows_the_effect_and_the_version_of_its_source(
    site: Path, made: tuple[Path, str], run: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _ = made
    monkeypatch.chdir(folder)
    shards = {path: path.stat().st_mtime_ns for path in folder.glob("data/*/*.h5")}
    assert "data" in run(site, *SNOWY)
    assert {path: path.stat().st_mtime_ns for path in shards} == shards, "made again"
    assert "4 of 4 pairs" in run(site, "status", "data")
    assert "noise.drifting_snow" in run(site, *SNOWY[:-1], code=2)
    source = site / "mine/snow.py"
    text = source.read_text()
    source.write_text(text + "\n# another version\n")
    try:
        message = run(site, *SNOWY, code=2)
    finally:
        source.write_text(text)
    assert "extensions.0.source" in message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code", "answer"),
    [
        (("make", *FAST, "noise.drifting_snw.density=1"), 2, "mean noise.drifting_snow.density?"),
        (("make", *FAST, "noise.drifting_snow.densty=1"), 2, "drifting_snow.densty: unknown key"),
        (("make", "scenes=npz_foldr"), 2, "did you mean scenes=npz_folder"),
        (("make", "--help"), 0, "drifting_snow (mine-extensions 1.5)"),
        (("evaluate", "dataset=data", "baselines=[row_medan]"), 2, "did you mean row_median?"),
    ],
)
def test_typing_errors_and_help_know_the_package(
    words: tuple[str, ...], code: int, answer: str, site: Path, made: tuple[Path, str],
    run: Callable[..., str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(made[0])
    assert answer in run(site, *words, code=code)


@pytest.mark.slow
def test_a_reader_and_a_preset_make_pairs(
    site: Path, made: tuple[Path, str], run: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, printed = made
    assert "exit code 1" in printed.splitlines()
    assert "1 of 5 frames" in printed
    with simnfnd.PairDataset(folder / "dived", "all", trusted=True) as pairs:
        assert len(pairs) == 4
        assert pairs.form.config["sonar"]["beams"] == 256
        (stated,) = pairs.form.config["extensions"]
    assert (stated["kind"], stated["name"]) == ("reader", "npz_folder")
    monkeypatch.chdir(folder)
    assert "bad: cannot be read" in run(site, "status", "dived", "--failed", code=1)
    rerun = run(site, "status", "dived", "--rerun", "scheduler=serial", code=1)
    assert "0 of 1 frames work now" in rerun


@pytest.mark.slow
def test_a_method_of_a_package_is_judged(
    site: Path, made: tuple[Path, str], run: Callable[..., str], tmp_path: Path
) -> None:
    settings = ("baselines=[row_median]", "models=[]", "bootstrap=100", "workers=1", "out=report")
    run(site, "evaluate", f"dataset={made[0] / 'dived'}", *settings)
    assert any("row_median" in path.read_text() for path in tmp_path.rglob("*.csv"))
    # And so is a metric.
    assert any("shadow_depth" in path.read_text() for path in tmp_path.rglob("results.csv"))
    assert any("shadow_depth" in path.read_text() for path in tmp_path.rglob("*.html"))


def test_an_effect_is_used_from_a_script(site: Path) -> None:
    rgb, depth_m = frame()
    with installed(site):
        from mine.snow import DRIFTING_SNOW  # type: ignore[import-not-found]

        pair = simnfnd.make_pair(rgb, depth_m, **PLACE, effects=[DRIFTING_SNOW])
        without = simnfnd.make_pair(rgb, depth_m, **PLACE)
        assert float(pair.record["noise.drifting_snow.density"]) > 0
        assert "noise.drifting_snow.density" not in without.record
        np.testing.assert_array_equal(pair.clean, without.clean)
        assert (pair.noisy != without.noisy).any()
        word = "noise.drifting_snow.density=0.2"
        more = simnfnd.make_pair(rgb, depth_m, **PLACE, config=("render=analytic", word))
        assert more.record["noise.drifting_snow.density"] == 0.2


@pytest.mark.slow
def test_what_a_script_defines_itself_is_refused_by_workers(site: Path, tmp_path: Path) -> None:
    code = (site / "mine/snow.py").read_text() + (
        "\nfrom simnfnd import make_dataset\n"
        "from simnfnd.extensions import register_effect\n"
        "register_effect(DRIFTING_SNOW)\n"
        f"words = {['experiment=demo', *FAST, 'noise.drifting_snow.density=0.1']!r}\n"
        "try:\n    make_dataset(*words, out='data')\n"
        "except Exception as error:\n    print(error)\n"
        "print(make_dataset(*words, 'scheduler=serial', out='data').pairs)\n"
    )
    message = run_python(tmp_path / "nothing", tmp_path, code)
    assert "effect drifting_snow: is defined in the script or notebook itself" in message
    assert "4" in message.splitlines()


def test_a_metric_of_a_script_needs_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extensions, "_registered", {})
    register_metric(OwnMetric("brightness", lambda image, pair: float(image.mean())))
    own.refuse_metrics_of_scripts(1)
    with pytest.raises(FactoryError, match=r"metric brightness: .*workers=1"):
        own.refuse_metrics_of_scripts("auto")


def test_names_that_are_taken_or_unusable_are_refused() -> None:
    for name in ("speckle", "Bad Name", ""):
        with pytest.raises(ValueError, match=re.escape(repr(name))):
            register_effect(replace(EFFECTS["background"], name=name))
    with pytest.raises(ValueError, match="median"):
        register_method(REGISTRY["median"])
    row_median = REGISTRY["median"]
    wrong: dict[str, dict[str, Any]] = {
        "no default": {"grid": {"width": (3,)}},
        "no value": {"grid": {"size": ()}},
    }
    for problem, changes in wrong.items():
        with pytest.raises(ValueError, match=f"row_median.*{problem}"):
            register_method(replace(row_median, name="row_median", **changes))
    with pytest.raises(ValueError, match="psnr"):
        OwnMetric("psnr", lambda image, pair: 0.0)
    entry: Any = type("Entry", (), {"kind": "seabed"})
    with pytest.raises(ValueError, match="seabed"):
        register_reader(entry)


@pytest.mark.slow
def test_a_broken_package_is_named_and_disturbs_nothing_else(
    run: Callable[..., str], tmp_path: Path
) -> None:
    broken = tmp_path / "broken"
    write_package(broken)
    (broken / "mine/snow.py").write_text("import nothing_of_that_name\n")
    message = run(broken, *SNOWY, code=2)
    assert re.search(r"effect drifting_snow: mine-extensions 1\.5 cannot be loaded", message)
    run(broken, *SNOWY[:-1], "scheduler=serial")
    assert (tmp_path / "data/manifest.json").is_file()
