"""A run whose pairs are made in two stages."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.fake_source import FakeConfig, FakePreparer, GentleSource
from tests.run_fake import make


def staged(directory: Path, config: FakeConfig = FakeConfig(), **changes: Any):  # noqa: B008
    """`make` with frames that are prepared by other workers, in a folder beside the dataset."""
    config = replace(config, prepared=config.prepared or str(directory.parent / "prepared"))
    return make(directory, config, source=GentleSource, preparer=FakePreparer, **changes)
