"""What is used of other packages without being public there is still there."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

from simnfnd.factory.common import private_apis
from tests.project_files import ROOT

NAMES = (
    *("hydra._internal", "_forkserver_pid", '"_forkserver"'),
    *("._cache.load_overload", "_shutdown_workers", "torch._foreach"),
)


def test_hydra_has_a_loader_without_its_global_instance() -> None:
    loader = private_apis.hydra_loader("pkg://simnfnd.conf")
    parameters = inspect.signature(loader.load_configuration).parameters
    assert {"config_name", "overrides", "run_mode", "from_shell"} <= parameters.keys()
    assert "sonar" in loader.list_groups("")


def test_the_fork_server_tells_its_process_and_can_be_stopped() -> None:
    server = private_apis._fork_server()
    assert hasattr(server, "_forkserver_pid")
    assert callable(server._stop)
    process_id = private_apis.fork_server_pid()
    assert process_id is None or process_id > 0


def test_numba_says_whether_a_loop_is_on_disk() -> None:
    from simnfnd.factory.common.elementary import FLOATS, ranked

    signature = f"void({FLOATS}, int64[::1], float32[::1])"
    assert private_apis.has_compiled_form(ranked, signature)
    assert not private_apis.has_compiled_form(ranked, "void(int8)")


def test_torch_ends_reading_processes_and_averages_many_tensors() -> None:
    import torch
    from torch.utils.data import DataLoader

    loader: Any = DataLoader([0, 1], num_workers=1, persistent_workers=True)  # type: ignore[arg-type]
    private_apis.end_reading_processes(loader)
    assert next(iter(loader)) == 0
    processes = loader._iterator._workers
    private_apis.end_reading_processes(loader)
    assert not any(process.is_alive() for process in processes)
    averages = [torch.zeros(2), torch.ones(1)]
    private_apis.move_averages(averages, [torch.ones(2), torch.ones(1)], 0.25)
    assert [average.tolist() for average in averages] == [[0.25, 0.25], [1.0]]


def test_they_stand_in_one_module() -> None:
    own = Path(inspect.getfile(importlib.import_module(private_apis.__name__))).resolve()
    using = [
        path.relative_to(ROOT).as_posix()
        for room in ("factory", "models", "evaluation", "simnfnd", "benchmarks")
        for path in (ROOT / room).rglob("*.py")
        if path.resolve() != own and any(name in path.read_text() for name in NAMES)
    ]
    assert using == []
