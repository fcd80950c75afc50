"""Files that are small and make much, or never end: each is written into a folder and opened."""

from __future__ import annotations

import json
import lzma
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from simnfnd.factory.commands import status
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.check.validate import validate
from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.dataset.read.config_file import dataset_settings
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.render import view as views
from simnfnd.factory.render.cache.cache import Cache
from simnfnd.factory.render.mount import Mount
from simnfnd.factory.render.pack import PackViews, read_contents, write_pack
from simnfnd.factory.scheduler.lock import Lock
from tests.factory.dataset.hostile import admit, whole
from tests.factory.render.small_views import some_view
from tests.factory.test_small_files import LAUGHS, forged

_BIG = 1 << 30
_REF = FrameRef("a", "b", "c")


def _packed(codec: str, size: int = _BIG) -> bytes:
    """Zeros of so many bytes, in pieces so that making them takes no memory."""
    piece = bytes(1 << 24)
    if codec == "zstd":
        from backports import zstd

        packer: Any = zstd.ZstdCompressor()
    else:
        packer = lzma.LZMACompressor(preset=0) if codec == "lzma" else zlib.compressobj(9)
    return b"".join([*(packer.compress(piece) for _ in range(size >> 24)), packer.flush()])


def _lzf(size: int) -> bytes:
    """A zero, then it again and again: 264 bytes for every three."""
    return b"\x00\x00" + b"\xe0\xff\x00" * (size // 264)


def _chunk_bomb(folder: Path, codec: str, side: int) -> None:
    """One picture of a sound dataset, `side` pixels wide, that stands for a thousand times more."""
    whole(folder)
    path = folder / "train/shard-00000.h5"
    filters: dict[str, Any] = {"compression": {"gzip": "gzip", "lzf": "lzf"}.get(codec, 32015)}
    if codec == "zstd":
        import hdf5plugin

        filters = dict(hdf5plugin.Zstd())
    content = _lzf(side * side * 80) if codec == "lzf" else _packed(codec)
    with h5py.File(path, "r+") as file:
        for name in ("checksums", *file.attrs):
            if name.endswith("checksum"):
                del file.attrs[name]
            elif name == "checksums":
                del file[name]
        scales = [
            file.create_dataset(f"axes/wide{n}", data=np.arange(float(side))) for n in range(2)
        ]
        for name in ("noisy", "clean", "shadow"):
            dtype = file[name].dtype
            attributes = {k: v for k, v in file[name].attrs.items() if "DIMENSION" not in k}
            del file[name]
            stack = file.create_dataset(
                name, (4, side, side), dtype, chunks=(1, side, side), **filters
            )
            stack.attrs.update(attributes)
            for number, scale in enumerate(scales, start=1):
                scale.make_scale()
                stack.dims[number].attach_scale(scale)
            for row in range(4):
                stack.id.write_direct_chunk((row, 0, 0), content[: side * side])
        for name in ("range", "elevation", "valid_azimuth", "segmentation", "instance", "layers"):
            del file[name]
    admit(folder)


def _huge_table(folder: Path) -> None:
    """/meta of ten million rows in a file with a hole."""
    whole(folder)
    path = folder / "train/shard-00000.h5"
    with h5py.File(path, "r+") as file:
        kind = file["meta"].dtype
        del file["meta"]
        file.create_dataset("meta", (10_000_000,), kind)
        file["meta"][-1] = np.zeros((), kind)
    admit(folder)


def _view_bomb(codec: str) -> bytes:
    bomb = _packed(codec)
    precision = {"depth_step": 2e-4, "radiance_step": 5e-4, "block": 1, "codec": codec}
    sound = views.encode(some_view())
    head = forged(sound, parts=[len(bomb)] * 2, labelled=False, precision=precision)
    return head + bomb * 2


def _cache_entry(folder: Path, codec: str) -> None:
    path = folder / "ab/abc.view"
    path.parent.mkdir(parents=True)
    path.write_bytes(_view_bomb(codec))


def _pack(folder: Path, change: Callable[[dict[str, bytes]], int]) -> None:
    folder.mkdir()
    path = folder / "a.pack"
    write_pack(path, [_REF], lambda ref: some_view(), Mount(), "cycles")
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    compression = change(members)
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def _long_head(members: dict[str, bytes]) -> int:
    members["pack.json"] += b" " * (1 << 29)
    return zipfile.ZIP_DEFLATED


def _bomb_inside(members: dict[str, bytes]) -> int:
    members["000000.view"] = _view_bomb("zstd")
    return zipfile.ZIP_STORED


def _text(folder: Path, name: str, content: bytes) -> None:
    whole(folder)
    (folder / name).write_bytes(content)


def _pipe(folder: Path, name: str) -> None:
    whole(folder)
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)


def _pack_pipe(folder: Path) -> None:
    folder.mkdir()
    os.mkfifo(folder / "a.pack")


def _read(folder: Path) -> None:
    with PairDataset(folder) as pairs:
        list(pairs)


def _hold(folder: Path) -> None:
    with Lock(folder):
        pass


def _cached(folder: Path) -> None:
    if Cache(folder).get("abc") is None:
        raise ValueError("damaged entry, removed")


def _deep(folder: Path) -> None:
    if found := validate(folder, deep=True).errors:
        raise ValueError(str(found[0]))


_VALUES = json.dumps([[]] * 5_900_000, separators=(",", ":")).encode()

# Name -> (writes it into a new folder, opens it).
BOMBS: dict[str, tuple[Callable[[Path], None], Callable[[Path], Any]]] = {
    "gzip chunk of 1 GiB": (lambda f: _chunk_bomb(f, "gzip", 1100), _read),
    "gzip chunk, validate --deep": (lambda f: _chunk_bomb(f, "gzip", 1100), _deep),
    "zstd chunk of 1 GiB": (lambda f: _chunk_bomb(f, "zstd", 400), _read),
    "lzf chunk of 1.3 GB": (lambda f: _chunk_bomb(f, "lzf", 4096), _read),
    "/meta of 10 million rows": (_huge_table, _read),
    "zstd render of 2 GiB": (lambda f: _cache_entry(f, "zstd"), _cached),
    "lzma render of 2 GiB": (lambda f: _cache_entry(f, "lzma"), _cached),
    "pack.json of 512 MiB": (lambda f: _pack(f, _long_head), lambda f: read_contents(f / "a.pack")),
    "pack with a zstd bomb": (
        lambda f: _pack(f, _bomb_inside),
        lambda f: PackViews(str(f / "a.pack"), Mount()).view(_REF),
    ),
    "config.yaml of aliases": (lambda f: _text(f, "config.yaml", LAUGHS), dataset_settings),
    "config.yaml, base sixty": (
        lambda f: _text(f, "config.yaml", b"a: " + b"1:" * 1_500_000 + b"1"),
        dataset_settings,
    ),
    "config.yaml nested": (lambda f: _text(f, "config.yaml", b"[" * 1_000_000), dataset_settings),
    "manifest.json of lists": (lambda f: _text(f, "manifest.json", _VALUES), load_manifest),
    "manifest.json nested": (
        lambda f: _text(f, "manifest.json", b"[" * 100_000_000),
        load_manifest,
    ),
    "failed.jsonl of numbers": (
        lambda f: _text(f, "failed.jsonl", b"[" + b"7777," * 26_000_000 + b"7]"),
        lambda f: status.main([str(f)]),
    ),
    "pipe as config.yaml": (lambda f: _pipe(f, "config.yaml"), dataset_settings),
    "pipe as failed.jsonl": (lambda f: _pipe(f, "failed.jsonl"), lambda f: status.main([str(f)])),
    "pipe as status.json": (lambda f: _pipe(f, "status.json"), lambda f: status.main([str(f)])),
    "pipe as .lock": (lambda f: _pipe(f, ".lock"), _hold),
    "pipe as a shard": (lambda f: _pipe(f, "train/shard-00000.h5"), _read),
    "pipe as a pack": (_pack_pipe, lambda f: read_contents(f / "a.pack")),
}
# These are passed over without a word: nobody needs what they say.
PASSED_OVER = {"pipe as status.json", "pipe as .lock"}
