"""The rules of the house that a machine can check, and the declarations that an install needs."""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.project_files import ROOT, files, module_name, modules, project

# Slow or heavy to import: only inside the function that needs them.
HEAVY = (
    "bpy", "open3d", "torch", "matplotlib", "hdf5plugin", "pyarrow", "webdataset",
    "huggingface_hub", "rosbags",
)  # fmt: skip


def requirements() -> list[Requirement]:
    declared = project()["project"]
    lists = [declared["dependencies"], *declared["optional-dependencies"].values()]
    found = [Requirement(line) for lines in lists for line in lines]
    return [one for one in found if one.name != declared["name"]]  # an extra made of extras


@cache
def pins() -> dict[str, Version]:
    found: dict[str, Version] = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            (only,) = pin.specifier
            assert only.operator == "==", line
            found[canonicalize_name(pin.name)] = Version(only.version)
    return found


@pytest.mark.parametrize("requirement", requirements(), ids=lambda requirement: requirement.name)
def test_every_dependency_is_pinned_within_its_bounds(requirement: Requirement) -> None:
    pinned = pins().get(canonicalize_name(requirement.name))
    assert pinned is not None, f"constraints.txt has no {requirement.name}"
    assert requirement.specifier.contains(pinned)


def test_everything_that_the_dependencies_need_is_pinned() -> None:
    # CUDA builds of torch need libraries that the CPU build of the list does not.
    cuda = ("nvidia-", "cuda-", "triton")
    waiting = [one for one in requirements() if one.marker is None or one.marker.evaluate()]
    seen: set[tuple[str, str]] = set()
    loose = set()
    while waiting:
        one = waiting.pop()
        name = canonicalize_name(one.name)
        if name.startswith(cuda):
            continue
        if name not in pins():
            loose.add(name)
        for extra in {"", *one.extras} - {extra for done, extra in seen if done == name}:
            seen.add((name, extra))
            try:
                lines = metadata.requires(name) or []
            except metadata.PackageNotFoundError:
                continue  # an extra that is not installed here
            needed = [Requirement(line) for line in lines]
            waiting += [r for r in needed if not r.marker or r.marker.evaluate({"extra": extra})]
    assert not loose, f"constraints.txt lacks {sorted(loose)}: run `make constraints`"


def test_the_two_versions_that_may_not_move() -> None:
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert "+" not in "".join(line for line in text.splitlines() if not line.startswith("#"))
    # The one that the index of the tests has as a CPU build: any other one brings gigabytes of
    # CUDA libraries.
    assert pins()["torch"] == Version("2.13.0"), "no CPU build of another torch is at hand"
    assert pins()["numpy"] < Version("2"), "bpy cannot load numpy 2"


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    # Assembled, so that this file does not hold what it forbids.
    places = "|".join(("work", "root", "tmp", "home", "opt", "Users", "mnt"))
    pattern = re.compile(rf"(?<![\w/.~}}\]-])/(?:{places})/[\w.-]")
    found = []
    for path in files():
        try:
            text = (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [
            f"{path}:{number}: {line.strip()[:80]}"
            for number, line in enumerate(text.splitlines(), start=1)
            if pattern.search(line)
        ]
    assert found == []


def test_no_module_of_the_factory_imports_anything_heavy() -> None:
    names = [module_name(path) for path in modules("factory")]
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}:\n"
        "    importlib.import_module(name)\n"
        f"    heavy = [h for h in {HEAVY!r} if h in sys.modules]\n"
        "    if heavy:\n"
        "        sys.exit(f'{name} imports {heavy} at module level')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr.strip()


def experiments() -> list[str]:
    return [path.stem for path in files() if path.match("conf/experiment/*.yaml")]


@pytest.mark.parametrize("name", experiments())
def test_an_experiment_begins_with_the_command_that_runs_it(name: str) -> None:
    lines = (ROOT / "conf" / "experiment" / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    # Hydra's own header may stand first.
    first = next(line for line in lines if not line.startswith("# @"))
    assert re.match(rf"# simnfnd (make|train) .*\bexperiment=\S*\b{name}\b", first), first
