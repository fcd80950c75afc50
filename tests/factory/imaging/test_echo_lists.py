"""/echoes: every echo behind a pair agrees with the pictures of the strongest, and is read back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory import pairs
from simnfnd.factory.config import FactoryConfig, digest, from_mapping, identity
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format import echoes as lists
from simnfnd.factory.dataset.format.checksums import crc32, seal
from simnfnd.factory.dataset.format.echoes import EchoList, read_echoes, write_echoes
from simnfnd.factory.dataset.format.schema import ECHO_FIELDS, Pair, Provenance
from simnfnd.factory.dataset.validate import shard_facts
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.frame import Frame
from simnfnd.factory.labels import CLASSES
from simnfnd.factory.sample_table.record import columns, image_axes
from tests.frames import POST_M, ground_and_post, plain_render
from tests.project_files import ROOT

PICTURES = ["range", "azimuth", "elevation", "elevation_min", "elevation_max", "segmentation"]
OFF = ("range_spreading", "multipath", "azimuth", "range_arc", "background")
SHARD = "train/shard-00000.h5"


def config(formation: str = "points", layout: str = "polar", **keys: Any) -> FactoryConfig:
    dataset = {"layers": [*PICTURES, "echoes"]}
    sonar = {"image": {"layout": layout}, "vfov_deg": 60, "beams": 96, "range_bins": 160}
    if formation == "field":
        keys["noise"] = {name: {"enabled": False} for name in OFF} | {"speckle": {}, "receiver": {}}
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "sonar": sonar,
            "acoustics": {"formation": formation},
            "dataset": dataset,
            **keys,
        }
    )


def labelled() -> Frame:
    frame = ground_and_post(480, 320)
    post = frame.depth_m == np.float32(POST_M)
    return replace(
        frame,
        segmentation=np.where(post, CLASSES.index("Pillar"), 0).astype(np.uint8),
        instance=np.where(post, 7, 0).astype(np.uint16),
    )


def observed(how: FactoryConfig, frame: Frame | None = None) -> pairs.ObservedFrame:
    frame = frame or labelled()
    return pairs.observe(frame, plain_render(frame), how)


@pytest.mark.parametrize("formation", ["points", "field"])
def test_lists_agree_with_the_pictures_of_the_strongest(formation: str) -> None:
    seen = observed(config(formation))
    echoes, picture = seen.echoes, seen.layers
    assert echoes is not None
    assert echoes.grid == (160, 96)
    bins = np.asarray(echoes["bin"])
    first = np.flatnonzero(np.diff(bins, prepend=-1))
    assert len(first) > 3000
    assert len(bins) > 10 * len(first), "many echoes a bin"
    where = np.unravel_index(bins[first], echoes.grid)
    for take, name in ((np.minimum, "elevation_min"), (np.maximum, "elevation_max")):
        limit = take.reduceat(np.asarray(echoes["elevation"]), first)
        np.testing.assert_array_equal(picture[name][where], limit)
        empty = np.ones(echoes.grid, np.bool_)
        empty[where] = False
        assert np.isnan(picture[name][empty]).all()
    # Of echoes of one strength the picture tells of the last.
    strength = np.asarray(echoes["strength"])
    strongest = []
    for begin, end in pairwise((*first.tolist(), len(bins))):
        strongest.append(end - 1 - int(strength[begin:end][::-1].argmax()))
    for name in ("range", "azimuth", "elevation", "segmentation", "instance"):
        np.testing.assert_array_equal(picture[name][where], echoes[name][strongest])


@pytest.mark.parametrize("formation", ["points", "field"])
def test_every_echo_is_a_pixel_of_the_camera(formation: str) -> None:
    frame = labelled()
    echoes = observed(config(formation), frame).echoes
    assert echoes is not None
    row, column = np.unravel_index(np.asarray(echoes["pixel"], np.int64), frame.depth_m.shape)
    lens = frame.intrinsics
    x, y = (column - lens.cx) / lens.fx, (row - lens.cy) / lens.fy
    z = frame.depth_m[row, column].astype(np.float64)
    np.testing.assert_allclose(echoes["range"], z * np.sqrt(1 + x**2 + y**2), rtol=1e-5)
    np.testing.assert_allclose(echoes["azimuth"], np.arctan(x), atol=2e-5)
    np.testing.assert_allclose(echoes["elevation"], np.arctan2(-y, np.hypot(1, x)), atol=2e-5)
    np.testing.assert_array_equal(echoes["instance"] == 7, z == np.float32(POST_M))
    assert len(np.unique(echoes["pixel"])) == len(echoes)


def test_a_bin_is_a_slice() -> None:
    seen = observed(config())
    echoes = seen.echoes
    assert echoes is not None
    low, high = (np.asarray(seen.layers[f"elevation_{end}"], np.float32) for end in ("min", "max"))
    span = np.nan_to_num(high - low)
    range_bin, beam = np.unravel_index(int(span.argmax()), span.shape)
    found = echoes["elevation"][echoes.in_bin(int(range_bin), int(beam))]
    assert np.ptp(found) == span.max() > np.deg2rad(5)
    assert len(found) == np.count_nonzero(echoes["bin"] == range_bin * 96 + beam)
    assert echoes["elevation"][echoes.in_bin(0, 0)].size == 0
    for outside in ((160, 0), (0, 96), (-1, 0)):
        with pytest.raises(IndexError, match="of 160 x 96"):
            echoes.in_bin(*outside)


def test_of_a_fan_they_are_those_of_its_range_bins_and_beams() -> None:
    fan, polar = (observed(config(layout=layout)).echoes for layout in ("fan", "polar"))
    assert fan is not None
    assert polar is not None
    assert fan.grid == polar.grid
    for name in polar.fields:
        np.testing.assert_array_equal(fan[name], polar[name])


def test_without_labels_there_are_none() -> None:
    how = config()
    how = replace(how, dataset=replace(how.dataset, layers=("echoes",)))
    echoes = observed(how, ground_and_post()).echoes
    assert echoes is not None
    assert not {"segmentation", "instance"} & set(echoes.fields)
    with pytest.raises(KeyError):
        echoes["instance"]


def test_asking_changes_nothing_else() -> None:
    asking = config()
    plain = replace(asking, dataset=replace(asking.dataset, layers=()))
    frame = labelled()
    with_list, without = (pairs.make_pair(observed(how, frame), 1, how) for how in (asking, plain))
    assert without.echoes is None
    assert with_list.noisy.tobytes() == without.noisy.tobytes()
    assert with_list.clean.tobytes() == without.clean.tobytes()
    assert with_list.record == without.record
    assert digest(identity(plain)) != digest(identity(asking))


def made(count: int = 2) -> tuple[FactoryConfig, list[Pair]]:
    """Two frames, so many variants of each."""
    how, small = config(), ground_and_post(240, 160)
    labels = np.zeros(small.depth_m.shape, np.uint8)
    other = replace(small, segmentation=labels, instance=labels.astype(np.uint16))
    found = []
    for frame in (labelled(), other):
        seen = observed(how, frame)
        found += [pairs.make_pair(seen, variant, how) for variant in range(count)]
    return how, found


def write(folder: Path, how: FactoryConfig, samples: list[Pair]) -> Path:
    write_shard(
        folder, SHARD, samples, image_axes(how.sonar), columns(how.noise),
        Provenance({}, "0" * 16, "tests"), how.dataset,
    )  # fmt: skip
    return folder / SHARD


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("echoes")
    write(where, *made())
    return where


def test_lists_are_read_back(folder: Path) -> None:
    _, samples = made()
    assert shard_facts(folder / SHARD, deep=True).problems == ()
    with PairDataset(folder) as dataset:
        for number, sample in enumerate(samples):
            found = dataset.echoes(number)
            assert sample.echoes is not None
            assert found.grid == sample.echoes.grid
            assert list(found.fields) == list(sample.echoes.fields)
            for name, values in sample.echoes.fields.items():
                assert found[name].dtype == values.dtype
                np.testing.assert_array_equal(found[name], values)
        assert len(dataset.echoes(-1)) == len(dataset.echoes(3))
        np.testing.assert_array_equal(dataset[1]["noisy"], samples[1].noisy)
    with h5py.File(folder / SHARD) as file:
        place = file["echoes/place"][()]
        # Variants of one frame share its list.
        np.testing.assert_array_equal(place[0], place[1])
        np.testing.assert_array_equal(place[2], place[3])
        assert (place[0, 0], place[0, 1], place[2, 1]) == (0, place[2, 0], len(file["echoes/bin"]))
        for field in ECHO_FIELDS:
            stored = file[f"echoes/{field.name}"]
            assert (stored.dtype, stored.attrs["units"]) == (np.dtype(field.dtype), field.units)


def _read_all(folder: Path) -> None:
    with PairDataset(folder) as dataset:
        for number in range(len(dataset)):
            dataset.echoes(number)


def test_a_dataset_without_says_so(tmp_path: Path) -> None:
    how, samples = made(1)
    write(tmp_path, how, [replace(sample, echoes=None) for sample in samples])
    with pytest.raises(FactoryError, match=r"shard-00000\.h5: has no echoes.*dataset\.layers"):
        _read_all(tmp_path)


@settings(max_examples=30, deadline=None)
@given(lengths=st.lists(st.integers(0, 40), min_size=1, max_size=6), data=st.data())
def test_any_lists_come_back(lengths: list[int], data: st.DataObject) -> None:
    rng = np.random.default_rng(0)
    own = []
    for length in lengths:
        fields = {f.name: rng.integers(0, 2, length).astype(f.dtype) for f in ECHO_FIELDS}
        fields["bin"] = np.sort(rng.integers(0, 12, length)).astype(np.int32)
        own.append(EchoList((3, 4), fields))
    samples = [one for one in own for _ in range(data.draw(st.integers(1, 3)))]
    with h5py.File("x.h5", "w", driver="core", backing_store=False) as file:
        sums = write_echoes(file, samples)
        table = np.zeros(len(samples), [(name, "<u4") for name in sums])
        for name, values in sums.items():
            table[name] = values
        file["checksums"] = table
        for row, sample in enumerate(samples):
            found = read_echoes(file, row)
            assert lists.echo_problem(found) is None
            for name in sample.fields:
                np.testing.assert_array_equal(found[name], sample[name])
                assert sums[f"echoes/{name}"][row] == crc32(sample[name])
            for flat in range(12):
                np.testing.assert_array_equal(
                    found["range"][found.in_bin(*divmod(flat, 4))],
                    sample["range"][sample["bin"] == flat],
                )
        assert len(file["echoes/bin"]) == sum(lengths)


def _set(name: str, at: Any, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[f"echoes/{name}"][at] = value

    return change


def _swap(name: str, values: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[f"echoes/{name}"]
        if values is not None:
            file[f"echoes/{name}"] = values

    return change


def _chunked(file: h5py.File) -> None:
    values = file["echoes/range"][()]
    del file["echoes/range"]
    file.create_dataset("echoes/range", data=values, chunks=(64,), compression="gzip")


def _linked(file: h5py.File) -> None:
    del file["echoes"]
    file["echoes"] = h5py.ExternalLink("/etc/hostname", "/")


HARM: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "beyond": (_set("place", (0, 1), 10**9), "beyond their end"),
    "before": (_set("place", (0, 0), -1), "beyond their end"),
    "backwards": (_set("place", (1, 0), 10**6), "beyond their end"),
    "other rows": (_swap("place", np.zeros((3, 2), np.int64)), "must be 4 pairs of int64"),
    "absent": (_swap("strength", None), "must hold bin, range"),
    "one label": (_swap("instance", None), "must hold bin, range"),
    "more": (lambda file: file.__setitem__("echoes/more", [1]), "must hold bin, range"),
    "short": (_swap("strength", np.zeros(3, np.float32)), "lists of different lengths"),
    "wide": (_swap("strength", np.zeros(3)), "must be a list of float32"),
    "chunked": (_chunked, "the schema keeps it in one piece"),
    "linked": (_linked, "is a link to elsewhere"),
    "grid": (lambda file: file["echoes/bin"].attrs.__setitem__("grid", [0, 9]), "claims 0 x 9"),
    "no grid": (lambda file: file["echoes/bin"].attrs.pop("grid"), "does not say"),
    "unsorted": (_set("bin", 3, 10**5), "bin is not ascending"),
    "steep": (_set("elevation", 5, 2.0), "elevation has values outside"),
    "NaN": (_set("range", 5, np.nan), "range has values outside 0"),
    "no class": (_set("segmentation", 5, 200), "segmentation has values outside 0..20"),
}


def _seal(file: h5py.File) -> None:
    """True checksums of whatever is there."""
    sums = file["checksums"][()]
    for row, (first, end) in enumerate(file["echoes/place"][()]):
        for name in sums.dtype.names:
            field = name.removeprefix("echoes/")
            if name.startswith("echoes/") and field in file["echoes"]:
                sums[name][row] = crc32(file[name][max(first, 0) : end])
    file["checksums"][...] = sums
    seal(file, sums.dtype.names)


@pytest.mark.parametrize("harm", sorted(HARM))
def test_what_is_no_list_is_told(folder: Path, tmp_path: Path, harm: str) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes((folder / SHARD).read_bytes())
    change, words = HARM[harm]
    with h5py.File(path, "r+") as file:
        change(file)
        if not isinstance(file.get("echoes", getlink=True), h5py.ExternalLink) and all(
            f"echoes/{name}" in file for name in ("strength", "instance")
        ):
            _seal(file)
    (problem, *_) = shard_facts(path, deep=True).problems
    assert words in problem
    assert "\n" not in problem


@pytest.mark.parametrize("name", ["elevation", "bin", "place"])
def test_a_flipped_bit_is_told(folder: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / SHARD
    path.parent.mkdir()
    with h5py.File(folder / SHARD) as file:
        start = file[f"echoes/{name}"].id.get_offset()
    content = bytearray((folder / SHARD).read_bytes())
    content[start + 40] ^= 1
    path.write_bytes(content)
    assert shard_facts(path, deep=True).problems
    with pytest.raises(FactoryError, match=r"shard-00000\.h5"):
        _read_all(tmp_path)


def test_what_does_not_fit_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    how, samples = made(1)
    first, second = samples
    with pytest.raises(FrameError, match="sample 1: has echoes, or none, unlike"):
        write(tmp_path, how, [first, replace(second, echoes=None)])
    with pytest.raises(FrameError, match="sample 1: has echoes, or none, unlike"):
        write(tmp_path, how, [replace(first, echoes=None), second])
    assert second.echoes is not None
    odd = replace(second, echoes=replace(second.echoes, grid=(1, 9)))
    with pytest.raises(FrameError, match="differ in grid or labels"):
        write(tmp_path, how, [first, odd])
    monkeypatch.setattr(lists, "_MOST_BYTES", 10**6)
    with pytest.raises(FactoryError, match=r"echoes take .* GB of a shard.*scheduler\.shard_size"):
        write(tmp_path, how, samples)
    assert not (tmp_path / SHARD).exists()


def test_drawn_devices_are_refused_by_name() -> None:
    from simnfnd.models.data.renders import composed

    with pytest.raises(FactoryError, match=r"dataset\.layers: echoes are of the bins of one dev"):
        composed(("experiment=any_sonar", "dataset.layers=[echoes]"))


def test_example_of_the_echoes_of_a_bin(folder: Path) -> None:
    def run(*words: object) -> str:
        done = subprocess.run(
            [sys.executable, str(ROOT / "examples" / "bin_echoes.py"), *map(str, words)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    with PairDataset(folder) as dataset:
        echoes = dataset.echoes(0)
    head, *lines = run(folder).splitlines()
    assert head.endswith(f"of {len(echoes)} echoes")
    assert len(lines) > 2
    assert all("class" in line for line in lines)
    range_bin, beam = divmod(int(echoes["bin"][0]), 96)
    count = int(np.count_nonzero(echoes["bin"] == echoes["bin"][0]))
    there = f"range bin {range_bin}, beam {beam}: {count} of"
    assert run(folder, 0, range_bin, beam).startswith(there)
    assert "0 of" in run(folder, 0, 0, 0)
