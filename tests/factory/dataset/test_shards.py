"""Shards, manifest, folder, card and preview: what a stranger with h5py alone relies on."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.dataset.describe.card import write_card
from simnfnd.factory.dataset.describe.preview import preview, spread
from simnfnd.factory.dataset.format.manifest import (
    Manifest,
    ShardInfo,
    damage,
    load_manifest,
    save_manifest,
)
from simnfnd.factory.dataset.format.sample import Column, Pair
from simnfnd.factory.dataset.format.schema import Provenance, stored_image, table_dtype, table_row
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.read.overview import SampleName
from simnfnd.factory.dataset.write.failures import (
    Failure,
    add_failures,
    load_failures,
    save_failures,
)
from simnfnd.factory.dataset.write.folder import open_folder
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.files import check_writable, remove_stale_temporaries, write_atomically
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.ownership import space
from simnfnd.factory.settings import build
from tests.fake_source import FakeConfig, FakeSource, refs, rerun
from tests.project_files import ROOT

SOURCE = FakeSource(FakeConfig())
PROVENANCE = Provenance(
    {"seed": 7, "sonar": {"hfov_deg": 30.0}, "noise": {"density": {"uniform": [0.1, 0.5]}}},
    "c0ffee0123456789",
    "simnfnd 0.1.0",
)


def some_pairs(count: int = 3, scene: str = "alpha") -> list[Pair]:
    return [SOURCE.pairs(ref, (0,))[0] for ref in refs(count, scene)]


def write(
    root: Path,
    pairs: Any = None,
    relative: str = "train/shard-00000.h5",
    **changes: Any,
) -> ShardInfo | None:
    pairs = some_pairs() if pairs is None else pairs
    settings = DatasetSettings(**changes)
    return write_shard(root, relative, pairs, SOURCE.axes(), SOURCE.columns(), PROVENANCE, settings)


def dataset(root: Path) -> Manifest:
    """Two scenes that train, one that tests, in three shards, with a manifest."""
    manifest = open_folder(root, {"whole": True}, PROVENANCE)
    for relative, scene in (
        ("train/shard-00000.h5", "alpha"),
        ("train/shard-00001.h5", "beta"),
        ("test/shard-00000.h5", "gamma"),
    ):
        info = write(root, some_pairs(4, scene), relative)
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    return manifest


# --- one shard --------------------------------------------------------------------------------


def test_h5py_alone_reads_back_what_was_written(tmp_path: Path) -> None:
    pairs = some_pairs(3)
    info = write(tmp_path, iter(pairs))
    assert info is not None
    with h5py.File(tmp_path / info.path, "r") as file:
        assert set(file) == {"noisy", "clean", "shadow", "meta", "axes", "checksums"}
        for name in ("noisy", "clean", "shadow"):
            stack = file[name]
            np.testing.assert_array_equal(stack[:], [getattr(pair, name) for pair in pairs])
            assert stack.chunks == (1, 24, 20)
            assert (stack.compression, stack.compression_opts) == ("gzip", 1)
            assert stack.fletcher32
            assert not stack.shuffle
            assert [dimension.label for dimension in stack.dims] == ["sample", "ahead", "right"]
            for dimension, axis in enumerate(SOURCE.axes(), start=1):
                scale = stack.dims[dimension][0]
                assert scale.name == f"/axes/{axis.name}"
                assert scale.attrs["units"] == "m"
                np.testing.assert_array_equal(scale[:], axis.values)
        assert (file["noisy"].dtype, file["shadow"].dtype) == (np.uint8, np.bool_)
        table = file["meta"][:]
        assert table.dtype.names == tuple(column.name for column in SOURCE.columns())
        for row, pair in zip(table, pairs, strict=True):
            for name, value in pair.record.items():
                stored = row[name].decode() if isinstance(value, str) else row[name]
                assert stored == value
        assert file["meta"].attrs["noise.background.density.units"] == "1"
        assert file.attrs["schema"] == "simnfnd/1"
        assert file.attrs["split"] == "train"
        assert file.attrs["generator"] == "simnfnd 0.1.0"
        assert file.attrs["config_hash"] == "c0ffee0123456789"
        assert json.loads(file.attrs["config"]) == PROVENANCE.config
        assert list(file.attrs["value_range"]) == [0, 255]
    assert info.samples == 3
    assert info.split == "train"
    assert damage(tmp_path, info) is None


def test_bytes_repeat_in_another_second_and_another_process(tmp_path: Path) -> None:
    first = write(tmp_path / "one")
    time.sleep(1.1)  # HDF5's time stamps, which must not be there, count seconds
    second = write(tmp_path / "two")
    code = "import sys; from pathlib import Path; "
    code += "from tests.factory.dataset.test_shards import write; "
    code += "print(write(Path(sys.argv[1])).sha256)"
    third = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "three")],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    assert first is not None
    assert first == second
    assert third.stdout.strip() == first.sha256


@pytest.mark.parametrize("compression", ["gzip", "lzf", "none", "zstd"])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_every_compression_and_dtype_reads_back(
    tmp_path: Path, compression: str, dtype: str
) -> None:
    if compression == "zstd":
        pytest.importorskip("hdf5plugin")
    info = write(tmp_path, compression=compression, dtype=dtype)
    assert info is not None
    with h5py.File(tmp_path / info.path, "r") as file:
        noisy = file["noisy"][:]
        assert noisy.dtype == dtype
        assert file["noisy"].fletcher32 == (compression != "none")
    expected = np.stack([pair.noisy for pair in some_pairs()]).astype(float)
    scale = 255 if dtype == "float32" else 1
    np.testing.assert_allclose(noisy.astype(float) * scale, expected, atol=1e-4)


def test_zstd_without_hdf5plugin_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    with pytest.raises(FactoryError, match=r"dataset\.compression=zstd.*simnfnd\[zstd\]"):
        write(tmp_path, compression="zstd")


def test_no_pairs_make_no_file(tmp_path: Path) -> None:
    assert write(tmp_path, []) is None
    assert list(tmp_path.iterdir()) == []


def test_a_flipped_bit_is_noticed_by_the_reader_too(tmp_path: Path) -> None:
    info = write(tmp_path, compression="lzf")
    assert info is not None
    path = tmp_path / info.path
    with h5py.File(path, "r") as file:
        offset = file["noisy"].id.get_chunk_info(1).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 50] ^= 1
    path.write_bytes(content)
    assert damage(tmp_path, info) == "SHA-256 differs"
    with h5py.File(path, "r") as file, pytest.raises(OSError, match=r"checksum|filter"):
        file["noisy"][1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"noisy": np.zeros((24, 21), np.uint8)}, "noisy is (24, 21), its axes say (24, 20)"),
        ({"clean": np.zeros((24, 20), np.float64)}, "clean is float64"),
        ({"clean": np.full((24, 20), np.nan, np.float32)}, "or NaN"),
        ({"noisy": np.full((24, 20), 1.5, np.float32)}, "outside 0..1"),
        ({"shadow": np.zeros((24, 20), np.uint8)}, "shadow is uint8"),
    ],
)
def test_pairs_that_do_not_fit_are_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(FrameError) as caught:
        write(tmp_path, [replace(some_pairs(1)[0], **changes)])
    assert message in str(caught.value)
    assert not list(tmp_path.rglob("*.h5"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scene": "a-name-of-17-byte"}, "column scene holds 16 bytes"),
        ({"scene": "ünïcödé-zwölf"}, "column scene holds 16 bytes"),
        ({"scene": "nul\0"}, "NUL"),
        ({"scene": 5}, "holds text"),
        ({"variant": 2**31}, "column variant is int32"),
        ({"variant": 0.5}, "column variant is int32"),
        ({"variant": "3"}, "holds a number"),
        ({"variant": float("nan")}, "column variant is int32"),
        ({"variant": float("inf")}, "column variant is int32"),
        ({"frame": "\udcff"}, "is no text"),
        ({"extra": 1}, "disagree about extra"),
    ],
)
def test_the_table_never_loses_anything_in_silence(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    pair = some_pairs(1)[0]
    with pytest.raises(FactoryError) as caught:
        write(tmp_path, [replace(pair, record={**pair.record, **changes})])
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


COLUMNS = (
    Column("location", "S8"),
    Column("scene", "S8"),
    Column("frame", "S8"),
    Column("variant", "u1"),
    Column("gain", "f4"),
)


@given(
    text=st.text(max_size=12),
    variant=st.integers(-10, 300),
    gain=st.floats(allow_nan=False) | st.integers(-5, 5),
)
def test_a_row_is_stored_whole_or_refused(text: str, variant: int, gain: float) -> None:
    record = {"location": "", "scene": text, "frame": "0", "variant": variant, "gain": gain}
    try:
        row = np.array([table_row(COLUMNS, record, "frame")], table_dtype(COLUMNS))[0]
    except FrameError:
        too_long = len(text.encode(errors="surrogatepass")) > 8 or "\0" in text
        assert too_long or not 0 <= variant <= 255 or abs(gain) > 3.4e38
        return
    assert row["scene"].decode() == text
    assert row["variant"] == variant
    assert row["gain"] == np.float32(gain)


def test_columns_must_say_whose_sample_it_is() -> None:
    with pytest.raises(FactoryError, match="location, scene, frame, variant"):
        table_dtype(COLUMNS[1:])
    with pytest.raises(FactoryError, match="gain is O"):
        table_dtype((*COLUMNS[:4], Column("gain", "O")))


@given(st.integers(0, 255))
def test_grey_values_survive_both_dtypes(value: int) -> None:
    image = np.full((2, 2), value, np.uint8)
    stored = stored_image(image, "float32")
    assert stored.dtype == np.float32
    assert stored_image(stored, "uint8")[0, 0] == value
    assert stored_image(np.array([[0, 1]], np.float32), "uint8").tolist() == [[0, 255]]


def test_float_images_round_to_the_nearest_grey_value() -> None:
    image = np.array([[0.1, 0.5, 0.9]], np.float32)
    assert stored_image(image, "uint8").tolist() == [[26, 128, 230]]


# --- files and disks --------------------------------------------------------------------------


@pytest.fixture
def small_files() -> Iterator[None]:
    """No file may exceed 2000 bytes: to the writer the same as a disk that fills up."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.usefixtures("small_files")
def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no room to write") as caught:
        write(tmp_path)
    assert "\n" not in str(caught.value)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "manifest.json"
    write_atomically(path, b"old")

    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(FactoryError, match="No space left"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["manifest.json"]


def test_temp_files_of_the_dead_are_removed_and_of_the_living_left(tmp_path: Path) -> None:
    token = 16 * "0"
    here, elsewhere = f"here-{space()}", "here-ffffffff"
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = {
        f".shard-00000.h5.{here}-{dead.pid}-{token}.tmp": False,
        f".shard-00001.h5.{here}-{os.getpid()}-{token}.tmp": True,
        f".shard-00002.h5.{elsewhere}-{dead.pid}-{token}.tmp": True,
        f".shard-00003.h5.{elsewhere}-1-{token}.tmp": False,
        ".shard-00005.h5.older_version-1.tmp": True,
        "shard-00004.h5": True,
        ".notes.tmp": True,
    }
    for name in names:
        (tmp_path / name).touch()
    days_ago = time.time() - 3 * 86_400
    os.utime(tmp_path / f".shard-00003.h5.{elsewhere}-1-{token}.tmp", (days_ago, days_ago))
    assert remove_stale_temporaries(tmp_path) == 2
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {name for name, stays in names.items() if stays}


@pytest.mark.parametrize("folder", ["file/below", "/proc/nowhere"])
def test_a_folder_that_cannot_be_written_is_named_with_its_key(tmp_path: Path, folder: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FactoryError, match=r"dataset\.dir: cannot write .*; give a writable"):
        check_writable(tmp_path / folder, "dataset.dir")


# --- manifest, failures, folder ---------------------------------------------------------------


def test_manifest_reads_back_and_its_bytes_do_not_depend_on_order(tmp_path: Path) -> None:
    manifest = dataset(tmp_path)
    text = (tmp_path / "manifest.json").read_bytes()
    assert load_manifest(tmp_path) == manifest
    backwards = replace(manifest, shards=dict(reversed(list(manifest.shards.items()))))
    save_manifest(tmp_path, backwards)
    assert (tmp_path / "manifest.json").read_bytes() == text
    document = json.loads(text)
    assert document["totals"]["train"] == {
        "samples": 8,
        "shards": 2,
        "bytes": sum((tmp_path / f"train/shard-0000{k}.h5").stat().st_size for k in (0, 1)),
    }
    for shard in document["shards"]:
        assert damage(tmp_path, ShardInfo(**{**shard, "failed": ()})) is None


@pytest.mark.parametrize(
    "path",
    ["../secret.h5", "/etc/passwd", "train/../../x.h5", "test/shard-00000.h5", "train/x.txt"],
)
def test_a_manifest_that_names_files_elsewhere_is_refused(tmp_path: Path, path: str) -> None:
    dataset(tmp_path)
    document = json.loads((tmp_path / "manifest.json").read_text())
    train = next(shard for shard in document["shards"] if shard["split"] == "train")
    train["path"] = path
    (tmp_path / "manifest.json").write_text(json.dumps(document))
    with pytest.raises(FactoryError, match=r"manifest\.json: damaged"):
        load_manifest(tmp_path)


@given(cut=st.floats(0, 1), junk=st.binary(max_size=5))
def test_a_damaged_manifest_is_one_clear_line(
    tmp_path_factory: pytest.TempPathFactory, cut: float, junk: bytes
) -> None:
    folder = tmp_path_factory.getbasetemp() / "damaged-manifest"
    if not folder.exists():
        dataset(folder)
        (folder / "whole").write_bytes((folder / "manifest.json").read_bytes())
    whole = (folder / "whole").read_bytes()
    at = int(cut * len(whole))
    (folder / "manifest.json").write_bytes(whole[:at] + junk + whole[at + len(junk) :])
    try:
        load_manifest(folder)
        said = "run again"
    except FactoryError as error:
        said = str(error)
    assert "\n" not in said
    assert "run again" in said


def test_failures_tell_frame_reason_and_command_in_order(tmp_path: Path) -> None:
    failures = [
        Failure(
            FrameRef("reef", "beta", "2"), "crash", "reef/beta/2: died", "train/shard-00001.h5"
        ),
        Failure(FrameRef("reef", "beta", "1"), "frame", "reef/beta/1: NaN", "train/shard-00001.h5"),
        Failure(FrameRef("", "alpha", "9"), "timeout", "alpha/9: slow", "train/shard-00000.h5"),
    ]
    save_failures(tmp_path, failures, rerun)
    lines = [json.loads(line) for line in (tmp_path / "failed.jsonl").read_text().splitlines()]
    assert [line["frame"] for line in lines] == ["alpha/9", "reef/beta/1", "reef/beta/2"]
    assert lines[1]["reason"] == "reef/beta/1: NaN"
    assert lines[1]["command"] == "simnfnd make frames.only=[reef/beta/1]"


def test_failures_are_added_without_touching_those_before(tmp_path: Path) -> None:
    """A kill in the middle of a line costs that line alone, and the end puts all in order."""
    path = tmp_path / "failed.jsonl"
    found = [
        Failure(
            FrameRef("", "alpha", str(n)), "frame", f"alpha/{n}: NaN", f"train/shard-0000{n}.h5"
        )
        for n in range(3)
    ]
    save_failures(tmp_path, [], rerun)
    node = path.stat().st_ino
    for failure in reversed(found):
        before = path.read_bytes()
        add_failures(tmp_path, [failure], rerun)
        assert path.read_bytes().startswith(before)
    assert path.stat().st_ino == node
    assert [item["frame"] for item in load_failures(tmp_path)] == ["alpha/2", "alpha/1", "alpha/0"]
    path.write_bytes(path.read_bytes()[:-5])
    assert [item["frame"] for item in load_failures(tmp_path)] == ["alpha/2", "alpha/1"]
    save_failures(tmp_path, reversed(found), rerun)
    assert [item["frame"] for item in load_failures(tmp_path)] == ["alpha/0", "alpha/1", "alpha/2"]


def test_a_folder_of_the_same_dataset_is_taken_up(tmp_path: Path) -> None:
    manifest = dataset(tmp_path / "data")
    (tmp_path / "data/notes.txt").write_text("mine")
    assert open_folder(tmp_path / "data", {"whole": True}, PROVENANCE) == manifest
    config = (tmp_path / "data/config.yaml").read_text()
    assert yaml.safe_load(config) == {"whole": True}
    assert PROVENANCE.config_hash in config.splitlines()[0]
    (tmp_path / "data/manifest.json").unlink()
    assert open_folder(tmp_path / "data", {"whole": True}, PROVENANCE).shards == {}
    assert (tmp_path / "data/notes.txt").exists()


def test_another_configuration_is_refused_with_the_keys_that_differ(tmp_path: Path) -> None:
    dataset(tmp_path)
    other = replace(
        PROVENANCE,
        config_hash="deadbeef",
        config={"seed": 7, "sonar": {"hfov_deg": 45.0}, "noise": {"density": 0.3}},
    )
    with pytest.raises(FactoryError) as caught:
        open_folder(tmp_path, {}, other)
    message = str(caught.value)
    assert "sonar.hfov_deg 30.0 -> 45.0" in message
    assert "noise.density (absent) -> 0.3" in message
    assert "noise.density.uniform [0.1, 0.5] -> (absent)" in message
    assert "seed" not in message
    assert "\n" not in message
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(FactoryError, match="another configuration"):
        open_folder(tmp_path, {}, other)


def test_another_release_is_not_mixed_in(tmp_path: Path) -> None:
    dataset(tmp_path)
    with pytest.raises(FactoryError, match=r"made by simnfnd 0\.1\.0, this is simnfnd 9"):
        open_folder(tmp_path, {}, replace(PROVENANCE, generator="simnfnd 9"))


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(FactoryError, match=r"holds other files \(thesis\.tex\) and no dataset"):
        open_folder(tmp_path, {}, PROVENANCE)
    with pytest.raises(FactoryError, match="is a file"):
        open_folder(tmp_path / "thesis.tex", {}, PROVENANCE)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


# --- settings ---------------------------------------------------------------------------------


def test_settings_file_states_the_defaults() -> None:
    stated = yaml.safe_load((ROOT / "conf/dataset/default.yaml").read_text())
    assert build(DatasetSettings, stated) == DatasetSettings()
    assert set(stated) == set(DatasetSettings.__dataclass_fields__)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"compression": "bzip2"}, "dataset.compression"),
        ({"compression_level": 12}, "compression_level 12 must be 0 to 9 for gzip"),
        ({"name": "../evil"}, "name '../evil'"),
        ({"max_test": -1}, "dataset.max_test"),
        ({"dtype": "float64"}, "dataset.dtype"),
        ({"dirr": "x"}, "dataset.dirr: unknown key"),
        ({"dir": " "}, "dir must name a folder"),
    ],
)
def test_bad_settings_are_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(FactoryError) as caught:
        build(DatasetSettings, values, "dataset")
    assert message in str(caught.value)


def test_the_folder_is_named_by_the_config_unless_given() -> None:
    assert DatasetSettings().directory("0123456789abcdef") == Path("outputs/dataset-01234567")
    assert DatasetSettings(dir="mine").directory("0123") == Path("mine")
    assert DatasetSettings(max_test=5).limits == {"train": None, "test": 5}


# --- card and preview -------------------------------------------------------------------------


def test_the_card_says_what_is_there_and_its_code_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = dataset(tmp_path)
    failure = Failure(refs(1)[0], "frame", "bad", "train/shard-00000.h5")
    settings = DatasetSettings(name="reef", licence="CC-BY-4.0")
    path = write_card(tmp_path, manifest, PROVENANCE, settings, [failure], {"no depth": 3})
    _, front, body = path.read_text().split("---\n", 2)
    header = yaml.safe_load(front)
    assert header["license"] == "cc-by-4.0"
    assert header["size_categories"] == ["n<1K"]
    for text in (
        "# reef",
        "12 pairs",
        "8 train and 4 test",
        "| train | reef | beta | 4 |",
        "| test | reef | gamma | 4 |",
        "c0ffee0123456789",
        "| `hfov_deg` | 30 |",
        "drawn evenly from 0.1 to 0.5",
        "images left out: 3, no depth",
        "frames that failed: 1,",
        "Of this dataset: CC-BY-4.0.",
    ):
        assert text in body
    code = body.split("```python\n")[1].split("```")[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 5
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["noisy"].shape == (24, 20)
    assert names["made_from"]["scene"] == b"alpha"


def test_an_own_licence_is_told_to_the_hub_as_other(tmp_path: Path) -> None:
    manifest = dataset(tmp_path)
    for licence, expected in (
        ("Lab use only: ask", {"license": "other", "license_name": "lab-use-only-ask"}),
        (None, {"license": "unknown"}),
    ):
        write_card(tmp_path, manifest, PROVENANCE, DatasetSettings(licence=licence))
        header = yaml.safe_load((tmp_path / "README.md").read_text().split("---\n")[1])
        assert {key: value for key, value in header.items() if "license" in key} == expected


def test_the_contact_sheet_shows_the_pixels_of_the_shards(tmp_path: Path) -> None:
    from PIL import Image

    dataset(tmp_path)
    path = preview(tmp_path)
    assert path == tmp_path / "preview.png"
    first = path.read_bytes()
    preview(tmp_path, out=tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == first
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert image.shape[0] > 1000
    assert image.shape[1] > 2000
    # Shadows are the only blue thing on the sheet, echoes the only amber one.
    blue = (image[..., 2] > image[..., 0] + 60).mean()
    amber = (image[..., 0] > image[..., 2] + 60).mean()
    assert 0.005 < blue < 0.2
    assert 0.05 < amber < 0.6


def test_a_preview_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match=r"no manifest\.json"):
        preview(tmp_path)
    open_folder(tmp_path / "empty", {}, PROVENANCE)
    with pytest.raises(FactoryError, match="no samples"):
        preview(tmp_path / "empty")


@given(sizes=st.lists(st.integers(1, 9), min_size=1, max_size=12), count=st.integers(1, 20))
def test_a_preview_spreads_over_the_scenes(sizes: list[int], count: int) -> None:
    samples = [
        SampleName("train/shard-00000.h5", row, "train", "reef", f"{scene:02d}", f"{row}", 0)
        for scene, size in enumerate(sizes)
        for row in range(size)
    ]
    chosen = spread(samples, count)
    assert len(chosen) == len(set(chosen)) == min(count, len(samples))
    shown = {sample.scene for sample in chosen}
    assert len(shown) == min(count, len(sizes))
    shares = [sum(sample.scene == f"{k:02d}" for sample in chosen) for k in range(len(sizes))]
    full = [share for share, size in zip(shares, sizes, strict=True) if share < size]
    if count >= len(sizes) and full:
        assert max(shares) - min(full) <= 1


def test_slow_or_missing_libraries_are_not_imported_for_the_shards() -> None:
    code = "import sys, simnfnd.factory.jobs.run; print(*sorted(sys.modules))"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True
    )
    loaded = set(result.stdout.split())
    assert loaded.isdisjoint({"bpy", "open3d", "torch", "matplotlib", "cv2", "hdf5plugin"})
    assert len(loaded) > 50
