"""Datasets as an attacker leaves them: objects that no schema has."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.files import sha256_of
from simnfnd.factory.common.isolated import IsolatedProcess
from simnfnd.factory.dataset import PairDataset, validate
from simnfnd.factory.dataset import reader as shard_reader
from simnfnd.factory.dataset.layout import crc32, write_checksums
from simnfnd.factory.dataset.manifest import load_manifest, save_manifest
from simnfnd.factory.dataset.schema import Pair, Provenance, config_hash
from simnfnd.factory.dataset.writer import write_index
from tests.factory.dataset.some_shards import SHARDS, some_pairs, write_all

SECRET = 77
PROVENANCE = Provenance({"seed": 7}, config_hash({"seed": 7}), "simnfnd 0.1.0")


def with_layers(pair: Pair) -> Pair:
    """The pair with one optional layer of every dtype."""
    clean = np.asarray(pair.clean, np.uint8)
    is_seen = clean > 0
    range_m = np.where(is_seen, 3.0, np.nan).astype(np.float32)
    number = (clean > 200).astype(np.uint8)
    return replace(
        pair,
        layers={
            "range": range_m,
            "elevation": range_m / 10,
            "valid_azimuth": is_seen,
            "segmentation": number,
            "instance": number.astype(np.uint16),
            "layers/background": pair.noisy,
            "rgb": np.indices((6, 8, 3), np.uint8).sum(axis=0, dtype=np.uint8),
            "depth": np.where(is_seen[:6, :8], np.float32(2), np.float32(np.nan)),
        },
    )


def whole(root: Path, **changes: Any) -> Path:
    """A sound dataset of three shards with every layer, manifest and index; and a secret beside."""
    shards = {
        relative: [with_layers(pair) for pair in some_pairs(4, scene)]
        for relative, scene in SHARDS.items()
    }
    manifest = write_all(root, shards, PROVENANCE, **changes)
    write_index(root, manifest)
    with h5py.File(root.parent / "secret.h5", "w") as file:
        for name in ("noisy", "clean"):
            file[name] = np.full((4, 24, 20), SECRET, np.uint8)
        (root.parent / "secret.raw").write_bytes(bytes([SECRET]) * 4 * 24 * 20)
    return root


def keep_only(root: Path, relative: str) -> Path:
    """The dataset with one of its shards, and without an index; where one reader is asked often."""
    manifest = load_manifest(root)
    assert manifest is not None
    for path in manifest.shards:
        if path != relative:
            (root / path).unlink()
    (root / "index.h5").unlink()
    save_manifest(root, replace(manifest, shards={relative: manifest.shards[relative]}))
    return root


def reseal(file: h5py.File) -> None:
    """Make the checksums of a shard tell the truth, as who changed it on purpose would."""
    names = file["checksums"].dtype.names
    del file["checksums"]
    write_checksums(file, {name: [crc32(image) for image in file[name]] for name in names})


def admit(root: Path) -> None:
    """Make the manifest tell the truth about the files, as who made them on purpose would."""
    manifest = load_manifest(root)
    assert manifest is not None
    for path, info in manifest.shards.items():
        file = root / path
        if file.is_file():
            size = file.stat().st_size
            if size >= info.samples:
                manifest = manifest.with_shard(replace(info, bytes=size, sha256=sha256_of(file)))
    index = root / "index.h5"
    if index.is_file():
        manifest = replace(manifest, index_sha256=sha256_of(index))
    save_manifest(root, manifest)


def read_everything(root: Path) -> str:
    """Read a dataset as a user would: 'read', or the one line that refuses it; nothing hangs."""
    with mock.patch.object(shard_reader, "LIMIT_S", 2.0):
        try:
            for split in ("train", "test"):
                layers = ("noisy", "clean", "shadow", "range", "segmentation", "layers/background")
                with PairDataset(root, split, layers=layers) as pairs:
                    assert len(pairs) < 1000
                    pairs.meta()
                    _ = pairs.axes, pairs.shape, pairs.value_range
                    for sample in pairs:
                        for image in sample.values():
                            assert image.nbytes < 1 << 28
                            assert not (image == SECRET).all(), "read a file outside of the dataset"
        except FactoryError as error:
            return f"refused: {error}"
    return "read"


def check(root: Path, reader: IsolatedProcess) -> tuple[str, str]:
    """What reader and validator say of a dataset; AssertionError when it is no clear answer.

    reader: a process that may crash or hang instead of this one.
    """
    outcome = reader.call(read_everything, root, limit_s=30.0)
    assert outcome == "read" or outcome.startswith("refused: ")
    try:
        with mock.patch.object(validate, "LIMIT_S", 2.0):
            report = validate.validate(root, deep=True)
        verdict = "; ".join(report.errors) or "valid"
    except FactoryError as error:
        verdict = f"refused: {error}"
    for text in (outcome, verdict):
        assert "\n" not in text
        assert len(text) < 20_000
    return outcome, verdict


def _again(file: h5py.File, name: str, **keywords: Any) -> h5py.Dataset:
    """Another dataset of the same name, otherwise as the schema has it."""
    del file[name]
    form: dict[str, Any] = {"shape": (4, 24, 20), "dtype": "u1", "chunks": (1, 24, 20)}
    return file.create_dataset(name, **{**form, **keywords})


def _swap(file: h5py.File, name: str, secret: Path) -> None:
    file.move(name, "other")
    file.move("layers/background", name)
    file.move("other", "layers/background")


def _external_link(file: h5py.File, name: str, secret: Path) -> None:
    del file[name]
    file[name] = h5py.ExternalLink(str(secret), "/noisy")


def _soft_loop(file: h5py.File, name: str, secret: Path) -> None:
    del file[name]
    file[name] = h5py.SoftLink(f"/{name}")


def _virtual(file: h5py.File, name: str, secret: Path) -> None:
    del file[name]
    layout = h5py.VirtualLayout((4, 24, 20), "u1")
    layout[:] = h5py.VirtualSource(str(secret), "noisy", (4, 24, 20))
    file.create_virtual_dataset(name, layout)


def _external_storage(file: h5py.File, name: str, secret: Path) -> None:
    raw = secret.with_suffix(".raw")
    _again(file, name, chunks=None, external=[(str(raw), 0, h5py.h5f.UNLIMITED)])


def _bomb(file: h5py.File, name: str, secret: Path) -> None:
    """A chunk of 260 kB that grows to 260 MB."""
    stack = _again(file, name, compression="gzip")
    packer = zlib.compressobj(9)
    piece = packer.compress(bytes(1 << 22))
    zeros = b"".join([piece, *(packer.compress(bytes(1 << 26)) for _ in range(4)), packer.flush()])
    for row in range(4):
        stack.id.write_direct_chunk((row, 0, 0), zeros)


def _small_bomb(file: h5py.File, name: str, secret: Path) -> None:
    """A chunk as small as an image may be that grows to a thousand images."""
    stack = _again(file, name, compression="gzip")
    for row in range(4):
        stack.id.write_direct_chunk((row, 0, 0), zlib.compress(bytes(24 * 20 * 1000), 9))


def _attribute(file: h5py.File, name: str, value: Any) -> None:
    del file.attrs[name]
    file.attrs[name] = value


OBJECTS: dict[str, Callable[[h5py.File, str, Path], Any]] = {
    "swapped names": _swap,
    "absent": lambda file, name, secret: file.pop(name),
    "external link": _external_link,
    "link to itself": _soft_loop,
    "virtual dataset of another file": _virtual,
    "data in another file": _external_storage,
    "bomb": _bomb,
    "small bomb": _small_bomb,
    "a group": lambda file, name, secret: (file.pop(name), file.create_group(name)),
    "other dtype": lambda file, name, secret: _again(file, name, dtype="f8"),
    "text": lambda file, name, secret: _again(file, name, dtype=h5py.string_dtype()),
    "nested compound": lambda file, name, secret: _again(
        file, name, dtype=[("location", [("scene", "S3"), ("frame", "f4")]), ("variant", "i4")]
    ),
    "huge and empty": lambda file, name, secret: _again(
        file, name, shape=(2**40, 24, 20), maxshape=(None, 24, 20)
    ),
    "huge images": lambda file, name, secret: _again(
        file, name, shape=(4, 2**31, 2**31), chunks=(1, 2**15, 2**15)
    ),
    "no dimension": lambda file, name, secret: _again(file, name, shape=(), chunks=None),
    "no sample": lambda file, name, secret: _again(
        file, name, shape=(0, 24, 20), maxshape=(None, 24, 20)
    ),
    "contiguous": lambda file, name, secret: _again(file, name, chunks=None),
    "other chunks": lambda file, name, secret: _again(file, name, chunks=(2, 5, 5)),
    "scale-offset": lambda file, name, secret: _again(file, name, scaleoffset=2),
    "schema an array": lambda file, name, secret: _attribute(file, "schema", np.zeros(3)),
    "axes absent": lambda file, name, secret: file.pop("axes"),
    "no labels": lambda file, name, secret: file["noisy"].attrs.pop("DIMENSION_LABELS"),
}
