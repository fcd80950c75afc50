"""A sound dataset of the format, and a copy that a test may spoil."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.factory.dataset.hostile import whole


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole(tmp_path_factory.mktemp("sound") / "dataset")


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    """With the secrets beside it."""
    shutil.copytree(sound.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / "dataset"
