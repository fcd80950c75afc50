"""Arrays in NumPy's archives, MATLAB's files and HDF5: read, chosen by name, and given anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.models.recordings import Levels, is_recording, kind_of, open_recording
from simnfnd.models.recordings.arrays import split_name
from simnfnd.models.recordings.arrays.file import ArrayFile, is_table
from tests.models.recordings.array_files import write_array
from tests.models.recordings.recording_files import pings

NAMES = ("a.npz", "b.npz", "a.mat", "b.mat", "a.h5")


def array_of(path: Path, name: str) -> Any:
    """What a library that knows nothing of pictures reads."""
    if path.suffix == ".npz":
        return np.load(path)[name]
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            return file[f"sonar/{name}"][()]
    if path.stem == "b":
        found = scipy.io.loadmat(path)[name]
    else:
        with h5py.File(path) as file:
            found = file[name][()].transpose()
    return np.moveaxis(found, -1, 0) if found.ndim > 2 else found


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4", "f8"])
@pytest.mark.parametrize("name", NAMES)
def test_pictures_are_read_as_they_lie(tmp_path: Path, name: str, dtype: str) -> None:
    values = (pings(5, 30, 40) / (255 if dtype[0] == "f" else 1)).astype(dtype)
    path = write_array(tmp_path / name, values, poses=np.zeros((5, 4, 4)))
    assert (kind_of(path), is_recording(path), is_table(path)) == ("array", True, False)
    kept = values.astype("f4") if dtype[0] == "f" else values
    with open_recording(path) as recording:
        np.testing.assert_array_equal([frame.samples for frame in recording], kept)
        np.testing.assert_array_equal(recording[1].samples, kept[1])  # back again
        with pytest.raises(IndexError):
            recording[5]


@pytest.mark.parametrize("name", NAMES)
def test_colours_are_red_first(tmp_path: Path, name: str) -> None:
    coloured = np.random.default_rng(1).integers(0, 256, (5, 20, 24, 3), dtype=np.uint8)
    with open_recording(write_array(tmp_path / name, coloured)) as recording:
        np.testing.assert_array_equal(recording[4].samples, coloured[4, ..., ::-1])


@pytest.mark.parametrize("name", NAMES)
def test_a_single_picture(tmp_path: Path, name: str) -> None:
    picture = pings(1, 30, 40)[0]
    with open_recording(write_array(tmp_path / name, picture)) as recording:
        assert len(recording) == 1
        np.testing.assert_array_equal(recording[0].samples, picture)


@pytest.mark.parametrize("name", NAMES)
def test_of_several_arrays_one_is_named(tmp_path: Path, name: str) -> None:
    path = write_array(tmp_path / name, pings(5, 30, 40), other=pings(4, 20, 24))
    inside = "sonar/other" if path.suffix == ".h5" else "other"
    with pytest.raises(FactoryError, match=rf"{name}: holds several arrays .*name one, {name}::"):
        open_recording(path)
    assert is_recording(Path(f"{path}::{inside}"))
    with open_recording(f"{path}::{inside}") as recording:
        np.testing.assert_array_equal(recording[3].samples, pings(4, 20, 24)[3])
    with pytest.raises(FactoryError, match=r"no pictures named depth; it has .*other \("):
        open_recording(f"{path}::depth")
    with pytest.raises(FactoryError, match="no such file"):
        open_recording(tmp_path / f"absent{path.suffix}::{inside}")


def test_a_file_whose_name_has_colons_is_that_file(tmp_path: Path) -> None:
    path = write_array(tmp_path / "a.npz", pings(5, 30, 40)).rename(tmp_path / "a.npz::b.npz")
    assert split_name(path) == (path, None)
    assert split_name(tmp_path / "a.png::b") == (tmp_path / "a.png::b", None)
    with open_recording(path) as recording:
        assert len(recording) == 5


@pytest.mark.parametrize("name", NAMES)
def test_files_without_pictures_are_tables(tmp_path: Path, name: str) -> None:
    path = write_array(tmp_path / name, np.zeros((5, 4, 4)), times=np.zeros((1, 900)))
    assert kind_of(path) is None
    with pytest.raises(FactoryError, match=f"{name}: holds no pictures; expected"):
        open_recording(path)


@pytest.mark.parametrize("name", NAMES)
def test_a_copy_has_other_pictures_and_the_rest_as_it_was(tmp_path: Path, name: str) -> None:
    values = pings(5, 30, 40)
    path = write_array(tmp_path / name, values, poses=np.arange(80.0).reshape(5, 4, 4))
    target = tmp_path / "made" / name
    target.parent.mkdir()
    with ArrayFile(path) as file:
        copy = file.copy_with_others(target)
        for frame in file:
            copy.add(255 - frame.samples)
        copy.close()
    np.testing.assert_array_equal(array_of(target, "frames"), 255 - values)
    np.testing.assert_array_equal(array_of(target, "poses"), np.arange(80.0).reshape(5, 4, 4))
    np.testing.assert_array_equal(array_of(path, "frames"), values)


@pytest.mark.parametrize("name", NAMES)
def test_levels(tmp_path: Path, name: str) -> None:
    """Decibels: what lies beyond black and white, or was not measured, stays as it was."""
    decibels = np.linspace(-90, 10, 5 * 30 * 40).reshape(5, 30, 40)
    decibels[2, 3, 4] = np.nan
    path = write_array(tmp_path / name, decibels)
    with (
        open_recording(path) as recording,
        pytest.raises(FrameError, match=r"from 0 to 1, these are .*--levels BLACK WHITE"),
    ):
        recording[0]
    target = path.with_stem("b" if path.stem == "b" else "again")
    target = tmp_path / "made" / target.name
    target.parent.mkdir()
    with ArrayFile(path, Levels(-60, 0)) as file:
        shown = [frame.samples for frame in file]
        np.testing.assert_allclose(shown[2][5], np.clip(decibels[2, 5] / 60 + 1, 0, 1), atol=1e-6)
        assert shown[2][3, 4] == 0
        copy = file.copy_with_others(target)
        for number, picture in enumerate(shown):
            copy.add(file.stored(number, picture / 2))
        copy.close()
    found = array_of(target, "frames")
    within = (decibels >= -60) & (decibels <= 0)
    np.testing.assert_array_equal(found[~within], decibels[~within])
    np.testing.assert_allclose(found[within], decibels[within] / 2 - 30, atol=1e-4)


@given(
    values=st.lists(st.integers(-1000, 1000), min_size=4, max_size=4),
    black=st.integers(-900, 900),
    span=st.integers(-500, 500).filter(bool),
)
def test_levels_there_and_back(values: list[int], black: int, span: int) -> None:
    before = np.array(values, np.int16).reshape(2, 2)
    levels = Levels(black, black + span)
    shown = levels.shown(before)
    assert 0 <= shown.min() <= shown.max() <= 1
    np.testing.assert_array_equal(levels.stored(shown, before), before)


def test_columns_first(tmp_path: Path) -> None:
    values = np.asfortranarray(pings(5, 30, 40))
    np.savez(tmp_path / "a.npz", frames=values)
    with open_recording(tmp_path / "a.npz") as recording:
        np.testing.assert_array_equal(recording[3].samples, values[3])


def test_classes_of_matlab_that_are_no_pictures(tmp_path: Path) -> None:
    words = {"name": "lamprey", "cells": np.array([1, "a"], object), "nested": {"a": 1}}
    scipy.io.savemat(tmp_path / "b.mat", {"mask": np.zeros((40, 50), bool), **words})
    assert is_table(tmp_path / "b.mat")
    picture = pings(1, 40, 50)[0]
    scipy.io.savemat(tmp_path / "b.mat", {"picture": picture, **words})
    with ArrayFile(tmp_path / "b.mat") as file:
        copy = file.copy_with_others(tmp_path / "c.mat")
        copy.add(file[0].samples // 2)
        copy.close()
    found = scipy.io.loadmat(tmp_path / "c.mat", simplify_cells=True)
    np.testing.assert_array_equal(found["picture"], picture // 2)
    assert (found["name"], found["nested"]) == ("lamprey", {"a": 1})


def test_whole_numbers_of_class_double_stay_of_that_class(tmp_path: Path) -> None:
    """MATLAB stores them as small integers."""
    others = {"weights": np.arange(3) * 1j, "gains": np.arange(5.0)}
    path = write_array(tmp_path / "b.mat", pings(5, 30, 40).astype("f8"), **others)
    with (
        open_recording(path) as recording,
        pytest.raises(FrameError, match=r"from 0 to 1, these are 0 to 255.*--levels"),
    ):
        recording[0]
    with ArrayFile(path, Levels(0, 255)) as file:
        copy = file.copy_with_others(tmp_path / "c.mat")
        for frame in file:
            copy.add(file.stored(frame.number, frame.samples / 2))
        copy.close()
    assert scipy.io.whosmat(tmp_path / "c.mat") == scipy.io.whosmat(path)
    assert scipy.io.whosmat(path)[0][2] == "double"
    np.testing.assert_array_equal(
        scipy.io.loadmat(tmp_path / "c.mat")["weights"], [others["weights"]]
    )


def test_complex_echoes_are_refused(tmp_path: Path) -> None:
    path = write_array(tmp_path / "b.mat", pings(5, 30, 40) * 1j)
    with open_recording(path) as recording, pytest.raises(FrameError, match="their magnitude"):
        recording[0]


@pytest.mark.parametrize("kind", ["external file", "link", "virtual"])
def test_hdf5_that_points_elsewhere_is_not_followed(tmp_path: Path, kind: str) -> None:
    pictures = pings(3, 30, 40)
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["frames"] = pictures
    (tmp_path / "secret.raw").write_bytes(pictures.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        if kind == "external file":
            elsewhere = [(tmp_path / "secret.raw", 0, pictures.nbytes)]
            file.create_dataset("frames", pictures.shape, "u1", external=elsewhere)
        elif kind == "link":
            file["frames"] = h5py.ExternalLink(tmp_path / "secret.h5", "frames")
        else:
            layout = h5py.VirtualLayout(pictures.shape, "u1")
            layout[:] = h5py.VirtualSource(tmp_path / "secret.h5", "frames", pictures.shape)
            file.create_virtual_dataset("frames", layout)
    with pytest.raises(FactoryError, match="holds no pictures"):
        open_recording(tmp_path / "a.h5")
    with pytest.raises(FactoryError, match="no pictures named frames"):
        open_recording(f"{tmp_path / 'a.h5'}::frames")


def test_a_file_of_a_dataset_is_no_array(tmp_path: Path) -> None:
    path = write_array(tmp_path / "a.h5", pings(5, 30, 40))
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = "simnfnd/1"
    assert kind_of(path) is None
    with pytest.raises(FactoryError, match="a file of a SimNFND dataset"):
        open_recording(path)
