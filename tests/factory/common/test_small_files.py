"""Files of strangers beside the shards: pipes, bombs, nests; refused at once, in little memory."""

from __future__ import annotations

import json
import os
import signal
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from backports import zstd

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.small_files import read_regular
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.folder import dataset_settings
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.manifest import load_manifest
from simnfnd.factory.production.commands import status
from simnfnd.factory.production.scheduler.lock import owner_of
from simnfnd.factory.simulation.pairs.views import Cache, PackViews
from simnfnd.factory.simulation.render import view as views
from simnfnd.factory.simulation.render.base import CacheSettings, Mount, RenderSettings
from simnfnd.factory.simulation.render.pack import read_contents, write_pack
from tests.factory.dataset.hostile import whole
from tests.factory.simulation.render.small_views import some_view


@pytest.fixture(autouse=True)
def at_once() -> Iterator[None]:
    """A hang ends the test."""

    def late(number: int, frame: Any) -> None:
        raise AssertionError("took longer than 20 s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@contextmanager
def little_memory(most_mb: float) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most_mb * 1e6
    finally:
        tracemalloc.stop()


def refused(action: Callable[[], Any], words: str = "") -> str:
    """The one line of a refusal."""
    with pytest.raises(FactoryError, match=words) as caught:
        action()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
    return str(caught.value)


def test_a_pipe_in_a_dataset_blocks_no_reader(tmp_path: Path) -> None:
    folder = whole(tmp_path / "dataset")
    for name in ("config.yaml", "failed.jsonl", "status.json", ".lock"):
        os.mkfifo(folder / name)
        look_at(folder, name)
        (folder / name).unlink(missing_ok=True)
    (folder / "manifest.json").unlink()
    os.mkfifo(folder / "manifest.json")
    look_at(folder, "manifest.json")


def look_at(folder: Path, name: str) -> None:
    """Try what opens the small files of a dataset, of which `name` is a pipe."""
    verbs: list[Callable[[], Any]] = [
        lambda: status.main([str(folder)]),
        lambda: status.main([str(folder), "--failed"]),
        lambda: status.main([str(folder), "--rerun"]),
        lambda: dataset_settings(folder),
        lambda: PairDataset(folder, trusted=True)[0],
        lambda: owner_of(folder),
    ]
    said: list[str] = []
    for verb in verbs:
        try:
            verb()
        except FactoryError as error:
            said.append(str(error))
    assert all(name in line for line in said)
    assert said or name in ("status.json", ".lock")


def test_only_regular_files_of_bounded_size_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "long").write_bytes(bytes(101))
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero"), tmp_path / "long"):
        with pytest.raises(OSError, match=r"no regular file|longer than 100 bytes|directory"):
            read_regular(path, 100)
    assert read_regular(tmp_path / "long", 101) == bytes(101)


LAUGHS = b"a: &a [x, x]\n" + b"".join(
    b"%c: &%c [*%c, *%c]\n" % (n + 1, n + 1, n, n) for n in range(97, 117)
)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (LAUGHS, "aliases"),
        (b"[" * 5000, "nested too deeply"),
        (b"a: " + b"9" * 5000, "integer string"),
        (b"a: [", "expected"),
        (b"\xff\xfe", "decode"),
        (b"!!python/object/apply:os.system [ls]", "constructor"),
    ],
)
def test_yaml_that_would_do_harm_is_refused(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_bytes(content)
    refused(lambda: dataset_settings(tmp_path), rf"config\.yaml: .*{words}")


def test_json_that_would_do_harm_is_refused(tmp_path: Path) -> None:
    folder = whole(tmp_path / "dataset")
    for harm, words in ((b"[" * 100_000, "nested"), (b"9" * 5000, ".*integer string")):
        (folder / "manifest.json").write_bytes(b'{"schema":' + harm)
        refused(lambda: load_manifest(folder), rf"manifest\.json: damaged \({words}")
    (folder / "failed.jsonl").write_bytes(b'{"frame": ' + b"[" * 10_000 + b"\n")
    refused(lambda: status.main([str(folder)]), r"failed\.jsonl: cannot be read")
    (folder / "failed.jsonl").write_bytes(b"\xff\n")
    refused(lambda: status.main([str(folder)]), r"failed\.jsonl: cannot be read")
    (folder / "failed.jsonl").unlink()
    (folder / "failed.jsonl").mkdir()
    refused(lambda: status.main([str(folder)]), r"failed\.jsonl: cannot be read")


def head_of(content: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", content, 4)
    head: dict[str, Any] = json.loads(content[24 : 24 + length])
    return head


def forged(content: bytes, **changes: Any) -> bytes:
    """A view with another head, sealed again."""
    text = json.dumps({**head_of(content), **changes}).encode()
    return content[:4] + struct.pack("<I", len(text)) + views._checksum(text) + text


BOMB_BYTES = 1 << 27


def test_a_plane_makes_no_more_than_its_image(tmp_path: Path) -> None:
    bomb = zstd.compress(bytes(BOMB_BYTES))
    content = forged(views.encode(some_view()), parts=[len(bomb)] * 2, labelled=False)
    cache = Cache(CacheSettings(dir=str(tmp_path)))
    path = tmp_path / "ab" / "abc.view"
    path.parent.mkdir()
    path.write_bytes(content + bomb * 2)
    with little_memory(4):
        with pytest.raises(ValueError, match="does not hold"):
            views.decode(content + bomb * 2)
        assert cache.get("abc") is None
    assert not path.exists()


@pytest.mark.parametrize(
    "changes",
    [
        {"shape": [1 << 20, 1 << 20]},
        {"shape": [-1, -1]},
        {"shape": [1e3, 2]},
        {"shape": "ab"},
        {"parts": [1 << 60, 1]},
        {"parts": []},
        {"precision": {"depth_step": 2e-4, "radiance_step": 0.1, "block": 4, "codec": "lzma"}},
        {"intrinsics": {"fx": "a", "fy": 1, "cx": 1, "cy": 1, "distortion": []}},
        {"mount": {"translation_m": 7}},
        {"mount": [1]},
    ],
)
def test_heads_that_make_no_sense_are_damage(changes: dict[str, Any]) -> None:
    sound = views.encode(some_view())
    head = forged(sound, **changes)
    rest = sound[24 + len(json.dumps(head_of(sound))) :]
    with little_memory(8), pytest.raises(ValueError, match=r"\w"):
        views.decode(head + rest)


def test_packs_that_would_do_harm_are_refused(tmp_path: Path) -> None:
    pack = tmp_path / "a.pack"
    write_pack(
        pack, [FrameRef("a", "b", "c")], lambda ref: some_view(), Mount(), RenderSettings("cycles")
    )
    with zipfile.ZipFile(pack) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def write(head: bytes, compression: int = zipfile.ZIP_STORED) -> None:
        with zipfile.ZipFile(pack, "w", compression) as archive:
            for name, content in {**members, "pack.json": head}.items():
                archive.writestr(name, content)

    write(members["pack.json"] + b" " * BOMB_BYTES, zipfile.ZIP_DEFLATED)
    with little_memory(4):
        refused(lambda: read_contents(pack), "pack.json is compressed")
    sound = members["pack.json"]
    for old, new in {
        b'"a"': b"[1]",
        b'"b"': b"7",
        b'"c"': b'"\\u0000"',
        b'"frames": [': b'"frames": {}, "other": [',
        b'"mount": {': b'"mount": 7, "other": {',
        b"{": b"[" * 9999,
    }.items():
        assert old in sound
        write(sound.replace(old, new, 1))
        refused(lambda: read_contents(pack), "no pack, or damaged")
    write(sound)
    assert len(read_contents(pack).members) == 1
    pack.unlink()
    os.mkfifo(pack)
    refused(lambda: read_contents(pack), "no regular file")
    refused(lambda: PackViews(str(pack), Mount()), "no regular file")
