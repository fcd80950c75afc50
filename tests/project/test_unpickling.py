"""No file is unpickled: a pickle from elsewhere can run any code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("factory", "models", "evaluation", "simnfnd", "tools", "benchmarks", "examples")
UNPICKLERS = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
OWN_PROCESSES = {
    Path("factory/common/workers/__init__.py"),
    Path("factory/common/workers/local.py"),
    Path("factory/production/scheduler/dask_cluster.py"),
}
"""Modules that exchange pickles with worker processes of their own run, over sockets."""


def modules() -> Iterator[Path]:
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            if not any(parent.is_symlink() for parent in path.parents):
                yield path


def unpickling(tree: ast.Module) -> Iterator[str]:
    """What in a module may unpickle a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            yield from (name for name in names if name.split(".")[0] in UNPICKLERS)
        elif isinstance(node, ast.ImportFrom):
            if (node.module or "").split(".")[0] in UNPICKLERS:
                yield f"from {node.module}"
        elif isinstance(node, ast.Call):
            arguments = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            function = ast.unparse(node.func)
            if function == "torch.load" and arguments.get("weights_only") != "True":
                yield ast.unparse(node)
            if arguments.get("allow_pickle") == "True" or function.endswith("read_pickle"):
                yield ast.unparse(node)


def test_no_module_unpickles_a_file() -> None:
    found = {
        str(path.relative_to(ROOT)): said
        for path in modules()
        if path.relative_to(ROOT) not in OWN_PROCESSES
        and (said := list(unpickling(ast.parse(path.read_text(encoding="utf-8")))))
    }
    assert found == {}


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from dill import load", "torch.load(path)", "np.load(p, allow_pickle=True)"],
)
def test_the_search_finds_unpickling(source: str) -> None:
    assert list(unpickling(ast.parse(source)))
