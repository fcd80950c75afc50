"""One small dataset with its renders for all tests of training data."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.models.data.small_renders import rendered_dataset


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A dataset, and a pack of its renders."""
    return rendered_dataset(tmp_path_factory.mktemp("rendered"))
