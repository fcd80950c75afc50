"""`simnfnd demo`: the same frames by both profiles."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from simnfnd.factory.commands import demo


def test_both_profiles_show_the_same_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = (
        "scenes.locations=2", "scenes.frames_per_location=1", "scenes.width=160",
        "scenes.height=120", "render=analytic", "scheduler=serial", "dataset.dir=first",
    )  # fmt: skip
    assert demo.main(words) == 0
    tables = []
    for folder in ("first", "first-physical"):
        with h5py.File(next((tmp_path / folder / "train").glob("*.h5"))) as shard:
            tables.append(shard["meta"]["scene", "frame"])
    assert np.array_equal(*tables)
    with Image.open(tmp_path / "first-profiles.png") as picture:
        # Two frames, both profiles of a frame in one row.
        assert picture.width > picture.height > 500
