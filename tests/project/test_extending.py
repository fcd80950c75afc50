"""A package outside of the repository adds an effect, a reader, a method and presets.

It is written from the code of docs/extending.md, which thereby runs.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import simnfnd
from simnfnd.extensions import register_effect, register_method, register_reader
from simnfnd.factory import extensions
from simnfnd.factory.noise.registry import EFFECTS
from tests.project.test_face import PLACE, frame
from tests.project_files import ROOT

PAGE = (ROOT / "docs/extending.md").read_text(encoding="utf-8")
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


# Each command ends with a line of its exit code.
_COMMANDS = """
import json, sys
from simnfnd.command import main

for words in json.loads(sys.argv.pop()):
    sys.argv = ["simnfnd"]
    try:
        code = main(words)
    except SystemExit as stopped:
        code = stopped.code
    sys.stderr.flush()
    print(f"\\n{MARK}{int(code or 0)}", flush=True)
"""
_MARK = "exit code of this command: "


class Command(NamedTuple):
    """words: after `simnfnd`.  code: the exit code that is expected."""

    words: Sequence[str]
    code: int = 0


def run(site: Path, cwd: Path, *commands: Command) -> list[str]:
    """What each command prints where the package is installed.

    One process runs them all: most of the time of a small command is that of its imports.
    """
    code = _COMMANDS.replace("{MARK}", _MARK)
    output = run_python(site, cwd, code, json.dumps([command.words for command in commands]))
    *printed, rest = re.split(rf"\n{_MARK}(\d+)\n", output)
    assert rest == ""
    texts = printed[::2]
    codes = [int(number) for number in printed[1::2]]
    assert codes == [command.code for command in commands], output[-3000:]
    return texts


def test_an_effect_of_a_package_goes_all_the_way(site: Path, tmp_path: Path) -> None:
    words = ("make", "experiment=demo", *FAST, "dataset.dir=data")
    snowy = (*words, "noise.drifting_snow.density=0.1")
    run(site, tmp_path, Command(snowy))
    manifest = json.loads((tmp_path / "data/manifest.json").read_text())
    (stated,) = manifest["config"]["extensions"]
    assert (stated["kind"], stated["name"]) == ("effect", "drifting_snow")
    assert (stated["package"], stated["version"]) == ("mine-extensions", "1.5")
    assert manifest["config"]["noise"]["drifting_snow"]["enabled"] is True
    with simnfnd.PairDataset(tmp_path / "data", "all") as pairs:
        table = pairs.meta()
        assert set(table["noise.drifting_snow.density"]) == {0.1}
        assert (table["points.drifting_snow"] > 0).all()
    shards = {path: path.stat().st_mtime_ns for path in (tmp_path / "data").glob("*/*.h5")}
    again, status, plain = run(
        site, tmp_path, Command(snowy), Command(("status", "data")), Command(words, code=2)
    )
    assert "data" in again
    assert {path: path.stat().st_mtime_ns for path in shards} == shards, "made again"
    assert "4 of 4 pairs" in status
    assert "noise.drifting_snow" in plain
    source = site / "mine/snow.py"
    before = source.read_text()
    source.write_text(before + "\n# another version\n")
    (message,) = run(site, tmp_path, Command(snowy, code=2))
    source.write_text(before)
    assert "another configuration" in message
    assert "extensions" in message


def test_typing_errors_and_help_know_the_package(site: Path, tmp_path: Path) -> None:
    words = ("make", "experiment=demo", *FAST)
    effect, key, preset, help_text, method = run(
        site,
        tmp_path,
        Command((*words, "noise.drifting_snw.density=1"), code=2),
        Command((*words, "noise.drifting_snow.densty=1"), code=2),
        Command(("make", "scenes=npz_foldr"), code=2),
        Command(("make", "--help")),
        Command(("evaluate", "dataset=x", "baselines=[row_medan]"), code=2),
    )
    assert "did you mean noise.drifting_snow.density?" in effect
    assert "noise.drifting_snow.densty: unknown key" in key
    assert "did you mean scenes=npz_folder" in preset
    assert "drifting_snow (mine-extensions 1.5)" in help_text
    assert "x: no such folder" in method or "did you mean row_median?" in method


def test_a_reader_and_a_preset_make_pairs_that_a_method_judges(site: Path, tmp_path: Path) -> None:
    rgb, depth_m = frame()
    for scene in ("one", "two"):
        (tmp_path / "dives" / scene).mkdir(parents=True)
        for number in range(2):
            far = np.nan_to_num(depth_m) * (1 + 0.1 * number)
            np.savez(tmp_path / f"dives/{scene}/{number}.npz", rgb=rgb, depth_m=far)
    (tmp_path / "dives/two/bad.npz").write_bytes(b"x")
    words = (
        "make", "scenes=npz_folder", "scenes.root=dives", "scenes.intrinsics=[120,120,76,48]",
        "sonar=mine_hf", "render=analytic", "scheduler.workers=2", "dataset.preview_pairs=0",
        "dataset.dir=data", "split.test=[two]",
    )  # fmt: skip
    evaluate = ("evaluate", "dataset=data", "baselines=[row_median]", "models=[]", "out=report")
    output, failed, rerun, _ = run(
        site,
        tmp_path,
        Command(words, code=1),
        Command(("status", "data", "--failed"), code=1),
        Command(("status", "data", "--rerun", "scheduler=serial"), code=1),
        Command(evaluate),
    )
    assert "1 of 5 frames" in output
    with simnfnd.PairDataset(tmp_path / "data", "all", trusted=True) as pairs:
        assert len(pairs) == 4
        assert pairs.form.config["sonar"]["beams"] == 256
        (stated,) = pairs.form.config["extensions"]
        assert (stated["kind"], stated["name"]) == ("reader", "npz_folder")
    assert "bad: cannot be read" in failed
    assert "0 of 1 frames work now" in rerun
    assert any("row_median" in path.read_text() for path in tmp_path.rglob("*.csv"))


def test_effects_and_readers_from_a_script(site: Path, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(site))
    from mine.snow import DRIFTING_SNOW  # type: ignore[import-not-found]

    rgb, depth_m = frame()
    try:
        pair = simnfnd.make_pair(rgb, depth_m, **PLACE, effects=[DRIFTING_SNOW])
        without = simnfnd.make_pair(rgb, depth_m, **PLACE)
        assert float(pair.record["noise.drifting_snow.density"]) > 0
        assert "noise.drifting_snow.density" not in without.record
        np.testing.assert_array_equal(pair.clean, without.clean)
        assert (pair.noisy != without.noisy).any()
        word = "noise.drifting_snow.density=0.2"
        more = simnfnd.make_pair(rgb, depth_m, **PLACE, config=("render=analytic", word))
        assert more.record["noise.drifting_snow.density"] == 0.2
    finally:
        extensions._registered.pop(("effect", "drifting_snow"))
        extensions._entry_points.cache_clear()
        EFFECTS.pop("drifting_snow")


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


def test_names_that_are_taken_or_broken_are_told(site: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    from simnfnd.evaluation.filters import REGISTRY

    for name in ("speckle", "Bad Name", ""):
        with pytest.raises(ValueError, match=re.escape(repr(name))):
            register_effect(replace(EFFECTS["background"], name=name))
    with pytest.raises(ValueError, match="median"):
        register_method(REGISTRY["median"])
    entry: Any = type("Entry", (), {"kind": "seabed"})
    with pytest.raises(ValueError, match="seabed"):
        register_reader(entry)
    broken = tmp_path / "broken"
    write_package(broken)
    (broken / "mine/snow.py").write_text("import nothing_of_that_name\n")
    words = ("make", "experiment=demo", *FAST)
    message, _ = run(
        broken,
        tmp_path,
        Command((*words, "noise.drifting_snow.density=0.1"), code=2),
        Command((*words, "dataset.dir=data")),
    )
    assert re.search(r"effect drifting_snow: mine-extensions 1\.5 cannot be loaded", message)
