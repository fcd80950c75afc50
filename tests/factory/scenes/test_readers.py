"""What all readers have in common."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes import Scenes
from simnfnd.factory.settings import build
from tests.factory.scenes.scene_files import DEPTH, PINHOLE, RGB, reader, write
from tests.project_files import ROOT


@pytest.mark.parametrize("kind", ["flsea", "csv_list"])
def test_missing_and_empty_roots_get_one_line(tmp_path: Path, kind: str) -> None:
    extra = {"intrinsics": PINHOLE} if kind == "csv_list" else {}
    (tmp_path / "empty").mkdir()
    for root in (tmp_path / "absent", tmp_path / "empty", tmp_path / "empty/file.csv"):
        if root.suffix:
            root.write_text("# nothing\n")
        with pytest.raises(FactoryError) as caught:
            reader(kind, root, **extra).discover()
        assert str(caught.value).startswith(f"scenes.root={root}: ")
        assert "\n" not in str(caught.value)
        assert not isinstance(caught.value, FrameError)
    for unset in ("", "???"):
        with pytest.raises(FactoryError, match=r"scenes\.root: a path is required"):
            build(Scenes, {"kind": kind, "root": unset, **extra}, "scenes")


def test_what_cannot_be_read_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("imgs/1.tiff", "depth/1_abs_depth.tif"):
        write(tmp_path / "canyons/u_canyon" / name, RGB)

    def closed(folder: Any = ".") -> Any:
        if str(folder).endswith("depth"):
            raise PermissionError(13, "Permission denied", str(folder))
        return scan(folder)

    scan = os.scandir
    monkeypatch.setattr("os.scandir", closed)
    with pytest.raises(FactoryError, match=r"^scenes\.root: .*/depth cannot be read"):
        reader("flsea", tmp_path).discover()


def test_a_pipe_in_a_list_is_a_bad_frame(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("1.png,1.tif\n")
    os.mkfifo(tmp_path / "1.png")
    csv_list = reader("csv_list", tmp_path / "frames.csv", intrinsics=PINHOLE)
    with pytest.raises(FactoryError, match="none of the 1 frames"):
        csv_list.discover()
    write(tmp_path / "1.tif", DEPTH)
    with pytest.raises(FrameError, match=r"1\.png: no regular file"):
        csv_list.load(csv_list.discover().frames[0])


@pytest.mark.parametrize("kind", ["flsea", "csv_list"])
def test_yaml_lists_every_key_with_the_default(kind: str) -> None:
    values = yaml.safe_load((ROOT / f"conf/scenes/{kind}.yaml").read_text())
    given = {key: value for key, value in values.items() if value != "???"}
    required = {"root": "x", **({"intrinsics": PINHOLE} if kind == "csv_list" else {})}
    settings: Any = build(Scenes, {"kind": kind, **required}, "scenes")
    assert set(values) == set(settings.__dataclass_fields__)
    assert build(Scenes, {**given, **required}, "scenes") == settings


def test_configuration_alone_loads_no_heavy_library() -> None:
    code = (
        "import sys, json, simnfnd.factory.scenes\n"
        "heavy = {'open3d', 'bpy', 'torch', 'matplotlib'}\n"
        "print(json.dumps(sorted(heavy & set(sys.modules))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == []
