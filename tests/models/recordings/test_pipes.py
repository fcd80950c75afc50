"""A named pipe given as an input is refused; it would wait for a writer for ever."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.pairs.views import ViewMaker
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.fan_tables import read_fans
from simnfnd.models.recordings.inputs import InputFile, find_items

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes of POSIX")


@pytest.fixture(params=[".png", ".mp4", ".npy", ".tif", ".aris", ".bag"])
def pipe(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"pipe{request.param}"
    os.mkfifo(path)
    return path


def test_a_pipe_is_no_input(pipe: Path, tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="pipe or device"):
        find_items([pipe], tmp_path / "out")
    with pytest.raises(FactoryError, match="pipe or device"):
        open_recording(pipe)


def test_a_pipe_in_a_folder_is_passed_over(pipe: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "image.png"), np.full((8, 8), 9, np.uint8))
    (item,) = find_items([tmp_path], tmp_path / "out")
    assert item.source.name == "image.png"


def test_a_pipe_is_no_table_of_fans(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fans.csv")
    with pytest.raises(FactoryError, match="cannot be read"):
        read_fans(tmp_path / "fans.csv")


def test_a_pipe_in_a_list_fails_its_frame(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), np.full((48, 64, 3), 9, np.uint8))
    os.mkfifo(tmp_path / "a.npy")
    (tmp_path / "list.csv").write_text("a.png,a.npy\n")
    config = compose_config(
        ["scenes=csv_list", f"scenes.file={tmp_path}/list.csv", "scenes.intrinsics=[60,60,32,24]"]
    )
    maker = ViewMaker(config)
    (ref,) = maker.reader.discover().frames
    with pytest.raises(FactoryError):
        maker.prepare(ref)


def test_the_sheet_of_the_longest_name_has_a_name_that_fits() -> None:
    relative = Path("dive", "a" * 250 + ".pgm")
    compared = InputFile(relative, relative).compared
    assert compared.parent == Path("compare/dive")
    assert len(compared.name) <= 255
