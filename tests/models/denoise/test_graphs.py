"""Which graphs are run: those that ship, those exported on this machine, those vouched for."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.denoise import runtime
from simnfnd.models.denoise.runtime import TorchNetwork, find_graph, structure
from simnfnd.models.networks.weights import KEY, read_weights
from simnfnd.models.pretrained import find_weights
from simnfnd.models.pretrained.graphs import VOUCHED, remember


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(VOUCHED, raising=False)


def stranger(folder: Path, **changes: object) -> tuple[Path, bytes]:
    """Weights like those that ship, with changes of their structure, and a graph beside them."""
    header, arrays = read_weights(find_weights("simnfnd"))
    model = {**header["model"], **changes}
    weights = folder / "own.safetensors"
    contiguous = {name: np.ascontiguousarray(values) for name, values in arrays.items()}
    save_file(contiguous, weights, {KEY: json.dumps({**header, "model": model})})
    graph = b"a loop of 2^62 steps " + json.dumps(structure(model), sort_keys=True).encode()
    weights.with_suffix(".onnx").write_bytes(graph)
    return weights, graph


def test_the_graph_that_ships_comes_before_one_beside_the_weights(tmp_path: Path) -> None:
    weights, content = stranger(tmp_path)
    graph = find_graph(weights)
    assert graph is not None
    assert graph.path == find_weights("simnfnd").with_suffix(".onnx")
    assert graph.content != content


def test_a_graph_of_a_stranger_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights, content = stranger(tmp_path, widths=[4, 8])
    assert find_graph(weights) is None
    digest = hashlib.sha256(content).hexdigest()
    monkeypatch.setattr(runtime, "find_spec", lambda name: None)
    with pytest.raises(FactoryError, match=f"{VOUCHED}={digest}"):
        TorchNetwork(weights, "cpu")
    monkeypatch.setenv(VOUCHED, digest)
    graph = find_graph(weights)
    assert graph is not None
    assert graph.content == content


def test_a_graph_that_was_exported_here_is_run_while_it_is_unchanged(tmp_path: Path) -> None:
    weights, content = stranger(tmp_path, widths=[4, 8])
    remember(content)
    assert find_graph(weights) is not None
    weights.with_suffix(".onnx").write_bytes(b"more " + content)
    assert find_graph(weights) is None
