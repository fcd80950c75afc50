"""docs/python.md: every example gives what stands there."""

from __future__ import annotations

import doctest
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.models.recordings.recording_files import pings, write_aris
from tests.project.frames import frame
from tests.project_files import ROOT
from tests.small_dataset import write_dataset


def test_the_examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, depth_m = frame()
    cv2.imwrite("frame.png", np.ascontiguousarray(rgb[..., ::-1]))
    cv2.imwrite(
        "frame_depth.png", np.rint(np.nan_to_num(depth_m, posinf=0) * 1000).astype(np.uint16)
    )
    write_aris(tmp_path / "dive.aris", pings(2, 40, 48))
    write_dataset(tmp_path / "dataset", train=4, test=2, size=32)
    page = ROOT / "docs/python.md"
    parsed = doctest.DocTestParser().get_doctest(
        page.read_text(encoding="utf-8"), {}, page.name, str(page), 0
    )
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    result = runner.run(parsed, out=said.append)
    assert result.failed == 0, "".join(said)
    assert result.attempted > 10
