"""Datasets that version 0.3 made are read: images, labels, fields, echoes, tables, verbs."""

from __future__ import annotations

import hashlib
import shutil
import tarfile
from pathlib import Path

import h5py
import pytest

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.layout import echo_names
from simnfnd.factory.dataset.manifest import load_manifest
from simnfnd.factory.dataset.reader import Split, reading
from simnfnd.factory.dataset.validate import validate
from simnfnd.factory.dataset.writer import write_index

# BLAKE2b (8 bytes) of all samples of a layer, as the readers of 0.3 gave them.
POINTS = {
    "train": {
        "noisy": "7021eebb4c29a90b", "clean": "220c9cbbfb63117d", "shadow": "02700cd6bebb14d5",
        "range": "c36339ee28a8da9c", "elevation": "04a39e7bba615433",
        "segmentation": "c2c2dc59b64fc00a", "instance": "238da45bebb9a314",
        "layers/multipath": "cf9783fe02d15074", "meta": "92549183673255f5",
    },
    "test": {
        "noisy": "3ba1473edff78f73", "clean": "ea5e6c6b01d66d27", "shadow": "32716dca98d89b10",
        "range": "3059673642545c8a", "elevation": "f77d6c1b32ac67d1",
        "segmentation": "21606b1aeb2a1b08", "instance": "2223f08f60746bfd",
        "layers/multipath": "99b9e6391889431b", "meta": "857f66deb62efe0c",
    },
}  # fmt: skip
FIELD = {
    "train": {
        "noisy": "57d1b15b1650cc81", "clean": "e836a7d58ad83fbd", "shadow": "006fb5b4c7491bd7",
        "intensity_db": "b7c5de244341901d", "field": "32e26a9a54160a87", "meta": "e9d4912356d8462a",
    },
    "test": {
        "noisy": "90f1c9df690d0137", "clean": "559b138d10fb0659", "shadow": "3d7bb226fbf7048a",
        "intensity_db": "317dcf9f3458ec6a", "field": "f570a438cd4ecf72", "meta": "99d3c8632444113c",
    },
}  # fmt: skip
EXPECTED = {"points": POINTS, "field": FIELD}


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """points: gzip, uint8, effects, labels, echoes.  field: lzf, float32, the received field."""
    folder = tmp_path_factory.mktemp("made")
    with tarfile.open(Path(__file__).parent / "made_by_0_3.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def digests(folder: Path, split: Split, names: list[str]) -> dict[str, str]:
    """Of every layer and of the table."""
    sums = {name: hashlib.blake2b(digest_size=8) for name in names}
    layers = [name for name in names if name != "meta"]
    with PairDataset(folder, split, layers=layers) as pairs:
        for sample in pairs:
            for name, image in sample.items():
                sums[name].update(image.tobytes())
        sums["meta"].update(pairs.meta().tobytes())
    return {name: actual.hexdigest() for name, actual in sums.items()}


@pytest.mark.parametrize("split", ["train", "test"])
@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_every_layer_is_what_0_3_read(datasets: Path, name: str, split: Split) -> None:
    expected = EXPECTED[name][split]
    assert digests(datasets / name, split, list(expected)) == expected


def index_content(path: Path) -> dict[str, str]:
    """Every attribute of an index but the descriptions of layers, in the words of this version."""
    content: dict[str, str] = {}

    def add(name: str, item: h5py.HLObject) -> None:
        content[name] = str(item)
        for key, value in item.attrs.items():
            if key != "description":
                content[f"{name}@{key}"] = str(value)

    with h5py.File(path) as file:
        add("", file)
        file.visititems(add)
        virtual = [file[name] for name in content if name in file and name.endswith("noisy")]
        assert all(layer.is_virtual for layer in virtual)
    return content


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_it_is_valid_and_the_index_is_the_same_but_for_descriptions(
    datasets: Path, tmp_path: Path, name: str
) -> None:
    folder = Path(shutil.copytree(datasets / name, tmp_path / name))
    (error,) = validate(folder, deep=True).errors
    assert error.startswith("error: index.h5: the manifest has no SHA-256")
    manifest = load_manifest(folder)
    index = folder / "index.h5"
    assert manifest is not None
    before = index_content(index)
    write_index(folder, manifest)
    assert index_content(index) == before
    assert validate(folder, deep=True).errors == ()
    content = index.read_bytes()
    index.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    (error,) = validate(folder).errors
    assert str(error).startswith("error: index.h5: its SHA-256 is not that of the manifest")


def test_lists_of_echoes_are_checked_and_left_to_h5py(datasets: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(datasets / "points", tmp_path / "points"))
    path = folder / "train/shard-00000.h5"
    with reading(path) as file:
        assert "echoes/elevation" in echo_names(file)
    with h5py.File(path, "r+") as file:
        file["echoes/place"][0, 0] += 1
    with pytest.raises(FactoryError, match="checksum"):
        PairDataset(folder, trusted=True)[0]


def test_verbs_take_it(datasets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = datasets / "points"
    main(["inspect", str(folder)])
    assert "samples      2 train, 2 test" in capsys.readouterr().out
    for to, word in (("png", "4 samples"), ("coco", "4 images"), ("webdataset", "4 samples")):
        main(["export", str(folder), "--to", to, "--out", str(tmp_path / to)])
        assert word in capsys.readouterr().out.replace("2 train samples and 2 test", "4")
    words = [
        "export",
        str(datasets / "field"),
        "--to",
        "huggingface",
        "--out",
        str(tmp_path / "hub"),
    ]
    assert main(words) == 2
    assert "parquet holds no complex numbers (field)" in capsys.readouterr().err
