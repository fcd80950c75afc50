"""What a run of one worker makes, to which nothing happened."""

from __future__ import annotations

import pytest

from tests.factory.production.scheduler.run_files import litter, shard_bytes
from tests.run_fake import make


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Path below the dataset -> content, of every shard."""
    directory = tmp_path_factory.mktemp("undisturbed") / "dataset"
    report = make(directory, workers=1)
    assert (report.samples, report.reused_shards, report.failures) == (32, 0, ())
    assert litter(directory) == []
    return shard_bytes(directory)
