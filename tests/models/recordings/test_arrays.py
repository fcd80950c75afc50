"""Arrays of NumPy and MATLAB as images and recordings, and how much they may unpack to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.recordings import base, is_recording, kind_of, open_recording
from simnfnd.models.recordings.arrays import is_table
from simnfnd.models.recordings.images import read_image
from tests.models.recordings.recording_files import pings, write_array

NAMES = ("a.npz", "b.npz", "a.mat", "b.mat")


def saved(path: Path, array: Any) -> Path:
    np.save(path, array)
    return path


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2", "f2", "f4", "f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_an_image_and_several(tmp_path: Path, dtype: str, order: Any) -> None:
    values = pings(3, 30, 40) / (255 if dtype[0] == "f" else 1)
    array = np.asarray(values.astype(dtype), order=order)
    single = saved(tmp_path / "one.npy", array[1])
    several = saved(tmp_path / "more.npy", array)
    assert (kind_of(single), is_recording(single)) == ("images", False)
    assert (kind_of(several), is_recording(several)) == ("array", True)
    remaining = np.dtype("f4") if dtype[0] == "f" else np.dtype(dtype).newbyteorder("=")
    assert read_image(single).dtype == remaining
    np.testing.assert_array_equal(read_image(single), array[1].astype(remaining))
    np.testing.assert_array_equal(read_image(several), array[0].astype(remaining))
    np.savez(tmp_path / "a.npz", frames=array)
    for path in (several, tmp_path / "a.npz"):
        with open_recording(path) as recording:
            np.testing.assert_array_equal(
                [frame.samples for frame in recording], array.astype(remaining)
            )
            np.testing.assert_array_equal(recording[2].samples, array[2].astype(remaining))


@pytest.mark.parametrize("name", NAMES)
def test_files_of_one_array_of_images(tmp_path: Path, name: str) -> None:
    """Colours are red first, tables beside it do not count, and of several none is taken."""
    coloured = np.random.default_rng(1).integers(0, 256, (5, 20, 24, 3), dtype=np.uint8)
    path = write_array(tmp_path / name, coloured, poses=np.zeros((5, 4, 4)))
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[4].samples, coloured[4, ..., ::-1])
        with pytest.raises(IndexError):
            recording[5]
    path = write_array(tmp_path / name, coloured, other=pings(4, 20, 24))
    with pytest.raises(FactoryError, match=rf"{name}: .*\.npy"):
        open_recording(path)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((400, 7)), np.zeros((50, 4, 4)), np.zeros(900), np.zeros((64, 64), bool),
        np.zeros((2, 3, 64, 64, 3)), np.zeros((64, 64), "M8[s]"), np.zeros((64, 64), complex),
    ],
    ids=lambda array: f"{array.shape} {array.dtype}",
)  # fmt: skip
def test_tables_are_no_images(tmp_path: Path, array: Any) -> None:
    """Poses and masks that lie beside images."""
    path = saved(tmp_path / "a.npy", array)
    assert kind_of(path) is None
    assert is_table(path)
    with pytest.raises(FactoryError, match=r"a\.npy: "):
        read_image(path)
    with pytest.raises(FactoryError, match="holds no "):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.full((20, 20), 3.5), "from 0 to 1, these are 3.5 to 3.5; scale them"),
        (np.full((20, 20), -40.0), "from 0 to 1, these are -40 to -40; scale them"),
        (np.full((20, 20), np.nan), "400 of 400 pixels are NaN"),
        (np.full((20, 20), 1e300), "400 of 400 pixels are NaN or infinite"),
        (np.zeros((20, 20), np.int32), "pixels are int32; expected uint8, uint16, float32"),
    ],
)
def test_values_that_are_no_grey_values(tmp_path: Path, array: Any, words: str) -> None:
    with pytest.raises(FactoryError, match=f"a.npy: .*{words}"):
        read_image(saved(tmp_path / "a.npy", array))
    several = saved(tmp_path / "b.npy", np.stack([array, array]))
    with open_recording(several) as recording, pytest.raises(FactoryError, match=words):
        recording[1]


def test_files_that_are_no_arrays(tmp_path: Path) -> None:
    whole = saved(tmp_path / "whole.npy", pings(3, 30, 40)).read_bytes()
    path = tmp_path / "a.npy"
    for content in (b"", b"hello", whole[:60], whole[:200], b"\x93NUMPY\x09\x00" + whole[8:]):
        path.write_bytes(content)
        with pytest.raises(FactoryError, match=r"a.npy: .*array"):
            read_image(path)
    np.save(path, np.array([{1: 2}], dtype=object), allow_pickle=True)
    with pytest.raises(FactoryError, match="not a readable array"):
        read_image(path)


@pytest.mark.parametrize("name", ["a.npz", "doubles.mat"])
def test_bombs_are_refused_before_they_unpack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """A small file that says that it unpacks to more than may be."""
    monkeypatch.setattr(base, "ALWAYS_BYTES", 1 << 20)
    path = tmp_path / name
    stack = np.zeros((100, 256, 256), np.float32)  # MATLAB stores whole numbers as small ones
    if path.suffix == ".npz":
        np.savez_compressed(path, a=stack)
    else:
        scipy.io.savemat(path, {"a": stack}, do_compression=True)
    with pytest.raises(FactoryError, match=rf"{name}.*: unpacks to "):
        open_recording(path)
