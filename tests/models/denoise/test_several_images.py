"""Files of several images: animations, TIFF of other programs, arrays of MATLAB and HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from PIL import Image

from simnfnd import denoise
from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.denoise.video_writer import TimedImage
from simnfnd.models.denoise.writers import write_frames
from simnfnd.models.recordings import kind_of, open_recording
from tests.models.denoise.untrained import main
from tests.models.recordings.recording_files import pings


def animated(path: Path, frames: Array, **more: Any) -> Path:
    first, *others = map(Image.fromarray, frames)
    first.save(path, save_all=True, append_images=others, duration=120, **more)
    return path


@pytest.mark.parametrize("name", ["a.gif", "a.png", "a.webp"])
def test_animations_come_back_frame_by_frame(tmp_path: Path, name: str) -> None:
    frames = pings(5, 31, 47) // 2  # Pillow keeps a colour of a GIF for what stays
    path = animated(tmp_path / name, frames, **({"lossless": True} if ".webp" in name else {}))
    assert kind_of(path) == "animation"
    with open_recording(path) as recording:
        np.testing.assert_array_equal([frame.samples for frame in recording], frames)
        np.testing.assert_array_equal(recording[3].samples, frames[3])
        changed = np.concatenate([frames[:3] // 2, frames[2:3] // 2, frames[4:]])
        written = [TimedImage(image, duration_s=0.12) for image in changed]
        write_frames(tmp_path / "out" / name, written, recording)
    with open_recording(tmp_path / "out" / name) as again:
        actual = list(again)
        np.testing.assert_array_equal([frame.samples for frame in actual], changed)
    assert [frame.duration_s for frame in actual] == [0.12] * 5
    with Image.open(tmp_path / "out" / name) as image:
        assert getattr(image, "n_frames", 1) == 5, "other programs see every frame, repeated or not"


def test_deep_and_coloured_animations(tmp_path: Path) -> None:
    deep = pings(3, 24, 32).astype(np.uint16) * 17
    path = animated(tmp_path / "deep.png", deep)
    coloured = np.random.default_rng(0).integers(0, 256, (3, 24, 32, 3), dtype=np.uint8)
    animation = animated(tmp_path / "a.webp", coloured, lossless=True)
    for file, expected in ((path, deep), (animation, coloured[..., ::-1])):
        with open_recording(file) as recording:
            frames = [frame.samples for frame in recording]
            np.testing.assert_array_equal(frames, expected)
            write_frames(tmp_path / "out" / file.name, map(TimedImage, frames), recording)
        with open_recording(tmp_path / "out" / file.name) as again:
            np.testing.assert_array_equal([frame.samples for frame in again], expected)


@pytest.mark.parametrize("name", ["a.gif", "a.png"])
@pytest.mark.parametrize("share", [0.4, 0.7, 0.95])
def test_an_animation_that_is_cut_short(tmp_path: Path, name: str, share: float) -> None:
    frames = pings(6, 40, 50) // 2
    path = animated(tmp_path / name, frames)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with open_recording(path) as recording:
        actual = [frame.samples for frame in recording]
        assert "cut short" in recording.warning
        assert len(actual) == len(recording) == int(6 * share - 0.05)
    np.testing.assert_array_equal(actual, frames[: len(actual)])


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2", "f4"])
def test_images_behind_one_directory(tmp_path: Path, dtype: str) -> None:
    """As ImageJ writes more than 4 GB, and what is left of a stack of tifffile."""
    frames = (pings(6, 40, 50) / (255 if dtype == "f4" else 1)).astype(dtype)
    native = frames.astype(frames.dtype.newbyteorder("="))
    path = tmp_path / "imagej.tif"
    tifffile.imwrite(path, native, imagej=True, truncate=True)
    order: Any = ">" if dtype.startswith(">") else None
    cut = tmp_path / "cut.tif"
    tifffile.imwrite(cut, frames, byteorder=order)
    cut.write_bytes(cut.read_bytes()[: 600 + int(4.5 * frames[0].nbytes)])
    for file, count in ((path, 6), (cut, 4)):
        assert kind_of(file) == "stack"
        with open_recording(file) as recording:
            np.testing.assert_array_equal([frame.samples for frame in recording], native[:count])
            assert len(recording) == count
            assert ("cut short" in recording.warning) == (count < 6)


def test_pages_that_are_cut_short(tmp_path: Path) -> None:
    frames = pings(6, 40, 50)
    path = tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as writer:
        for frame in frames:
            writer.write(frame, contiguous=False, compression="zlib", metadata=None)
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    with open_recording(path) as recording:
        actual = [frame.samples for frame in recording]
        assert "cut short" in recording.warning
    assert 3 <= len(actual) <= 4
    np.testing.assert_array_equal(actual, frames[: len(actual)])


@pytest.mark.usefixtures("halving")
def test_a_tiff_of_doubles(tmp_path: Path) -> None:
    image = pings(1, 40, 50)[0] / 255
    tifffile.imwrite(tmp_path / "a.tif", image, compression="zlib")
    assert main([str(tmp_path / "a.tif"), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    np.testing.assert_allclose(tifffile.imread(tmp_path / "out" / "a.tif"), image / 2, atol=1e-6)


# --- arrays ---------------------------------------------------------------------------------------


def matlab_73(path: Path, name: str, array: Array, kind: str = "uint8") -> Path:
    """As save(..., '-v7.3') does: HDF5 behind 512 bytes, axes the other way round."""
    with h5py.File(path, "w", userblock_size=512) as file:
        stored = file.create_dataset(name, data=array.transpose(), compression=4)
        stored.attrs["MATLAB_class"] = np.bytes_(kind)
        title = file.create_dataset("title", data=np.zeros((1, 400), np.uint16))
        title.attrs["MATLAB_class"] = np.bytes_("char")
    content = bytearray(path.read_bytes())
    content[:128] = b"MATLAB 7.3 MAT-file, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("name", ["frames", "dive/frames"])
def test_matlab_73(tmp_path: Path, name: str) -> None:
    frames = pings(4, 30, 40)
    path = matlab_73(tmp_path / "a.mat", name, np.moveaxis(frames, 0, -1))
    with open_recording(path) as recording:
        np.testing.assert_array_equal([frame.samples for frame in recording], frames)


def test_structures_and_cells_of_matlab(tmp_path: Path) -> None:
    frames = pings(4, 30, 40)
    cells = np.empty(4, object)
    cells[:] = list(frames)
    several = np.empty(4, [("image", object), ("time", object)])
    for number, frame in enumerate(frames):
        several[number] = (frame, float(number))
    stacked = np.moveaxis(frames, 0, -1)
    for name, content in {
        "one": {"dive": {"sonar": {"frames": stacked}, "range_m": 5.0}},
        "cells": {"frames": cells},
        "array": {"dive": several},
    }.items():
        path = tmp_path / f"{name}.mat"
        scipy.io.savemat(path, content, do_compression=True)
        with open_recording(path) as recording:
            np.testing.assert_array_equal([frame.samples for frame in recording], frames)


@pytest.mark.usefixtures("halving")
def test_foreign_hdf5(tmp_path: Path) -> None:
    frames = pings(4, 30, 40)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("sonar/images", data=frames, compression=4)
        file.create_dataset("times", data=np.zeros(4))
    assert main([str(tmp_path / "a.h5"), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    denoised = np.load(tmp_path / "out" / "a.npy")
    assert np.abs(denoised - frames / 2).max() <= 0.5


def test_what_is_no_array_says_so_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.mat").write_text("1 2 3\n" * 40)
    (tmp_path / "empty.mat").write_bytes(b"")
    (tmp_path / "noise.mat").write_bytes(bytes(range(256)) * 4)
    scipy.io.savemat(tmp_path / "words.mat", {"a": "text", "b": {"c": 1.0}})
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file.create_dataset("times", data=np.zeros(4))
    for name, words in {
        "text.mat": "text file",
        "empty.mat": "not a readable array",
        "noise.mat": "not a readable array",
        "words.mat": "holds no images",
        "none.h5": "holds no images",
    }.items():
        with pytest.raises(FactoryError, match=words) as caught:
            open_recording(tmp_path / name)
        text = str(caught.value)
        assert "Traceback" not in text
        assert "File " not in text
        assert "\n" not in text
        assert name in text


def test_an_array_that_is_cut_short(tmp_path: Path) -> None:
    frames = pings(10, 30, 40)
    path = tmp_path / "a.npy"
    np.save(path, frames)
    np.savez(tmp_path / "a.npz", frames=frames)
    for file in (path, tmp_path / "a.npz"):
        content = file.read_bytes()
        file.write_bytes(content[: int(0.7 * len(content))])
    with pytest.raises(FactoryError, match=r"a\.npz: not a readable array"):
        open_recording(tmp_path / "a.npz")
    with open_recording(path) as recording:
        actual = [frame.samples for frame in recording]
        assert "cut short" in recording.warning
    assert 6 <= len(actual) <= 7
    np.testing.assert_array_equal(actual, frames[: len(actual)])


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
@pytest.mark.usefixtures("halving")
def test_one_channel_and_alpha_are_grey(tmp_path: Path, dtype: str) -> None:
    grey = (pings(1, 40, 50)[0] / (255 if dtype == "f4" else 1)).astype(dtype)
    alpha = np.full_like(grey, 1 if dtype == "f4" else 200)
    plain = denoise(grey, geometry=None)
    np.testing.assert_array_equal(denoise(grey[..., None], geometry=None)[..., 0], plain)
    both = denoise(np.stack([grey, alpha], axis=-1), geometry=None)
    np.testing.assert_array_equal(both[..., 0], plain)
    np.testing.assert_array_equal(both[..., 1], alpha)
    for number, array in enumerate((grey[..., None], np.stack([grey, alpha], axis=-1))):
        path = tmp_path / f"{number}.npy"
        np.save(path, array)
        assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
        result = np.load(tmp_path / "out" / path.name)
        assert result.shape == array.shape
        assert np.abs(result[..., 0].astype(float) - grey / 2).max() <= 0.5
        assert (result[..., 1:] == array[..., 1:]).all()
