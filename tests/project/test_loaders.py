"""The loaders of docs/python.md, each in a process that sees nothing but what its page names."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.project_files import ROOT
from tests.small_dataset import write_dataset

PAGE = (ROOT / "docs/python.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n# needs: (.*?)\n(.*?)```", PAGE, re.DOTALL)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Run by Python before anything else, in this process and in those it starts.
HIDE = """
import json, sys
from importlib.machinery import PathFinder

hidden = set(json.load(open({names!r})))

class Visible(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in hidden else super().find_spec(name, path, target)

sys.meta_path[:] = [Visible if finder is PathFinder else finder for finder in sys.meta_path]
"""


def requirements(name: str, extras: set[str]) -> list[Requirement]:
    """What a distribution with these extras requires here; nothing where it is not installed."""
    if name == "simnfnd":
        texts = list(PROJECT["dependencies"])
        for extra in extras:
            texts += PROJECT["optional-dependencies"][extra]
    else:
        try:
            texts = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            return []
    wanted = []
    for requirement in map(Requirement, texts):
        environments = [{"extra": extra} for extra in extras or {""}]
        if requirement.marker is None or any(map(requirement.marker.evaluate, environments)):
            wanted.append(requirement)
    return wanted


def installed_with(texts: str) -> set[str]:
    """Names of all distributions that `pip install TEXTS` would bring."""
    actual: set[tuple[str, frozenset[str]]] = set()
    waiting = [Requirement(text.strip()) for text in texts.split(", ")]
    while waiting:
        requirement = waiting.pop()
        key = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if key not in actual:
            actual.add(key)
            waiting += requirements(key[0], requirement.extras)
    return {name for name, _ in actual}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("needs", "code"), SNIPPETS, ids=[needs.split(", ")[-1] for needs, _ in SNIPPETS]
)
def test_a_loader_needs_what_the_page_says(needs: str, code: str, tmp_path: Path) -> None:
    write_dataset(tmp_path / "dataset", train=4, test=2, size=32)
    installed_names = installed_with(needs)
    hidden = [
        module
        for module, names in metadata.packages_distributions().items()
        if not {canonicalize_name(name) for name in names} & installed_names and module != "simnfnd"
    ]
    assert "bpy" in hidden
    assert "numpy" not in hidden
    (tmp_path / "hidden.json").write_text(json.dumps(hidden))
    start = HIDE.format(names=str(tmp_path / "hidden.json"))
    (tmp_path / "sitecustomize.py").write_text(start)
    paths = [str(tmp_path), *map(os.path.abspath, sys.path)]
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "HF_HUB_OFFLINE": "1",
             "HF_HOME": str(tmp_path / "hub-cache")},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    assert "32" in done.stdout
