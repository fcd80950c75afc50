"""Recordings where folders of real pictures are asked for."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from simnfnd.evaluation.recorded import open_real
from simnfnd.factory.errors import FactoryError
from tests.project_files import ROOT

LAMPREY = ROOT / "examples" / "didson" / "lamprey.avi"
ARIS = ROOT.parent / "shared" / "data" / "aris-sdk" / "sample.aris"


def test_the_fan_of_a_video_is_found_in_it(tmp_path: Path) -> None:
    shutil.copy(LAMPREY, tmp_path / "dive.avi")
    one, folder = open_real(LAMPREY)[0], open_real(tmp_path)[0]
    assert len(one) == len(folder) == 8
    assert folder[7].name == "dive.avi#7"
    first = one[0]
    assert first.known is not None
    sector = first.known.sector_mask(*first.read()[0].shape)
    assert first.read()[0][sector].mean() > 20 * first.read()[0][~sector].mean()
    assert one[0].known == one[7].known


@pytest.mark.skipif(not ARIS.is_file(), reason="no shared data")
def test_a_recording_says_where_range_and_bearing_are() -> None:
    found, _ = open_real(ARIS)
    assert len(found) == 6
    assert found[0].known is not None
    assert found[0].known.range_max_m == pytest.approx(23.3, abs=0.5)
    assert not np.array_equal(found[0].read()[0], found[5].read()[0])


def test_a_recording_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "dive.aris").write_bytes(b"no recording")
    with pytest.raises(FactoryError, match=r"dive\.aris"):
        open_real(tmp_path / "dive.aris")
    with pytest.raises(FactoryError, match="no such folder or recording"):
        open_real(tmp_path / "absent.aris")
