"""Layers rgb and depth: the frame that a pair was made of, as the reader has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from PIL import Image

from simnfnd.command import main
from simnfnd.factory.common.errors import FrameError
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.frames.frame import Frame
from simnfnd.factory.simulation.pairs.pair_maker import pair_maker
from simnfnd.factory.simulation.pairs.views import ViewMaker
from simnfnd.factory.simulation.scenes import open_reader
from tests.factory.production.cli_frames import ground, write_frame
from tests.frames import ground_and_post

LAYERS = ["rgb", "depth"]
SEABED = {"kind": "seabed", "locations": 1, "width": 96, "height": 64}


def config(folder: Path, scenes: dict[str, Any], **keys: Any) -> FactoryConfig:
    return from_mapping(
        {"scenes": scenes, "render": {"kind": "analytic"}, "cache": {"dir": str(folder)}, **keys}
    )


def recording(folder: Path, *sizes: tuple[int, int]) -> dict[str, Any]:
    """A list of frames of these (width, height), depth in whole millimetres."""
    lines = []
    for number, size in enumerate(sizes):
        frame = ground_and_post(*size)
        Image.fromarray(frame.rgb).save(folder / f"{number}.png")
        millimetres = np.rint(frame.depth_m * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(folder / f"{number}_depth.png")
        lines.append(f"{number}.png,{number}_depth.png,dive{number}\n")
    (folder / "frames.csv").write_text("".join(lines))
    lens = ground_and_post(*sizes[0]).intrinsics
    camera = [float(number) for number in (lens.fx, lens.fy, lens.cx, lens.cy)]
    return {"kind": "csv_list", "file": str(folder / "frames.csv"), "intrinsics": camera}


def assert_is_frame(layers: Any, frame: Frame) -> None:
    np.testing.assert_array_equal(layers["rgb"], frame.rgb)
    known = np.isfinite(layers["depth"])
    np.testing.assert_array_equal(known, frame.valid)
    np.testing.assert_array_equal(layers["depth"][known], frame.depth_m[known])


@pytest.mark.slow
def test_of_a_recording_they_are_the_readers_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Through the whole factory, with two noise variants of each frame."""
    scenes = recording(tmp_path, *[(96, 64)] * 4)
    words = [
        *("scenes=csv_list", f"scenes.file={scenes['file']}", "render=analytic"),
        f"scenes.intrinsics={scenes['intrinsics']}".replace(" ", ""),
        *("frames.variants=2", "scheduler=serial", "scheduler.shard_size=3"),
        *("dataset.layers=[depth,rgb]", "dataset.columns=[intrinsics]", "dataset.preview_pairs=0"),
        *(f"dataset.dir={tmp_path}/dataset", f"cache.dir={tmp_path}/cache"),
    ]
    main(["make", *words])
    reader = open_reader(config(tmp_path, scenes).scenes)
    frames = {ref.name: reader.load(ref) for ref in reader.discover().frames}
    with PairDataset(tmp_path / "dataset", "train", layers=["noisy", *LAYERS]) as pairs:
        table = pairs.meta()
        assert len(pairs) > 3
        for sample, row in zip(pairs, table, strict=True):
            names = (row[name].decode() for name in ("location", "scene", "frame"))
            frame = frames["/".join(filter(None, names))]
            assert_is_frame(sample, frame)
            lens = frame.intrinsics
            assert [row[f"camera.{name}_px"] for name in ("fx", "fy", "cx", "cy")] == [
                *(lens.fx, lens.fy, lens.cx, lens.cy)
            ]
            assert [row[f"camera.{name}"] for name in ("k1", "k2", "p1", "p2")] == [0, 0, 0, 0]
        several = pairs[0:4]
        assert several["rgb"].shape == (4, 64, 96, 3)
        np.testing.assert_array_equal(several["depth"][3], pairs[3]["depth"])
        with h5py.File(tmp_path / "dataset/index.h5") as index:
            np.testing.assert_array_equal(index["train/rgb"][:4], several["rgb"])
            assert index["train/depth"].dims[2].label == "camera_column"
    capsys.readouterr()
    main(["validate", str(tmp_path / "dataset"), "--deep"])
    main(["inspect", str(tmp_path / "dataset")])
    assert "camera       64 x 96 pixels (rgb, depth)" in capsys.readouterr().out
    main(["export", str(tmp_path / "dataset"), "--to", "png", "--out", str(tmp_path / "png")])
    drawn = cv2.imread(str(tmp_path / "png/train/rgb/000000.png"))
    assert drawn is not None
    np.testing.assert_array_equal(drawn[..., ::-1], several["rgb"][0])


def test_of_a_procedural_frame_whose_render_is_cached(tmp_path: Path) -> None:
    """The render has rounded the depth and lost what does not echo; the layer has not."""
    ref = FrameRef("seabed", "seabed-0000", "0001")
    settings = config(tmp_path, SEABED, dataset={"layers": LAYERS})
    ViewMaker(settings).prepare(ref)
    (pair,) = pair_maker(settings).pairs(ref, (0,))
    assert_is_frame(pair.layers, open_reader(settings.scenes).load(ref))
    assert pair.layers["rgb"].std() > 5
    plain = config(tmp_path, SEABED)
    (without,) = pair_maker(plain).pairs(ref, (0,))
    assert (without.noisy.tobytes(), without.record) == (pair.noisy.tobytes(), pair.record)


def test_a_frame_of_another_size_is_named(tmp_path: Path) -> None:
    """A list has one lens, so one size; FLSea's lens is scaled to each image."""
    for number, (width, height) in enumerate([(96, 64), (60, 40), (96, 64)]):
        write_frame(tmp_path / "videos", str(number), ground(height, width))
    scenes = {"kind": "flsea", "root": str(tmp_path / "videos")}
    settings = config(tmp_path, scenes, dataset={"layers": ["depth"]})
    first, small, third = open_reader(settings.scenes).discover().frames
    for ref in (first, small, third):
        ViewMaker(settings).prepare(ref)
    maker = pair_maker(settings)
    assert [maker.pairs(ref, (0,))[0].layers["depth"].shape for ref in (first, third)] == [
        *((64, 96), (64, 96))
    ]
    expected = rf"{small.name}: .* 60x40, that of {first.name} 96x64; .*depth out of dataset"
    with pytest.raises(FrameError, match=expected) as caught:
        maker.pairs(small, (0,))
    assert "\n" not in str(caught.value)
    # Of a dataset of that one alone it is the size.
    alone = config(tmp_path, scenes, dataset={"layers": LAYERS}, frames={"only": [small.name]})
    assert pair_maker(alone).pairs(small, (0,))[0].layers["rgb"].shape == (40, 60, 3)
