"""Local copies of datasets on a storage: small files at once, shards when they are asked for.

A copy is a folder like any dataset's, so that whatever reads a dataset reads it.  The oldest shards
go when all copies together take more than SIMNFND_CLOUD_CACHE_BYTES.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from ..errors import FactoryError
from ..files import explain_os_errors
from ..small_files import read_regular
from .store import Store, is_url

_ORIGIN = ".origin"
_SHARD = re.compile(r"(train|test)/[A-Za-z0-9_-]+\.h5")
# What lies beside the shards and is a reader's business.
_SMALL = re.compile(
    r"README\.md|config\.yaml|index\.h5|preview\.png|failed\.jsonl|manifest\.json"
    r"|(train|test)/shard-\d+\.json"
)
_MOST_SMALL_BYTES = 1 << 28
_KEPT_BYTES = 10_000_000_000
_LIMIT = "SIMNFND_CLOUD_CACHE_BYTES"
_LOCKS = 64  # lock files of each copy, which shards share by their names


def copies_folder() -> Path:
    """Where the copies are: SIMNFND_CLOUD_CACHE, or the user's folder for caches."""
    if told := os.environ.get("SIMNFND_CLOUD_CACHE"):
        return Path(told).absolute()
    base = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(base).absolute() / "simnfnd" / "cloud"


def folder_of(url: str, part: str = "") -> Path:
    """The folder of a dataset's copy; made, and known as that copy.

    part: of a run that makes a slice: runs side by side have copies of their own.
    """
    store = Store(url)
    digest = hashlib.blake2b(f"{store.url}\n{part}".encode(), digest_size=6).hexdigest()
    name = re.sub(r"[^A-Za-z0-9_-]", "_", store.url.rpartition("/")[2])[:40]
    folder = copies_folder() / f"{name}-{digest}"
    with explain_os_errors(folder, "SIMNFND_CLOUD_CACHE"):
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder / _ORIGIN, store.url.encode())
    return folder


def url_of(folder: Path) -> str | None:
    """The URL that `folder` is a copy of; None for any other folder.

    Only of our own place for copies: a stranger's dataset cannot send us anywhere.
    """
    where = Path(os.path.abspath(folder))
    if where.parent == copies_folder():
        with suppress(OSError, ValueError):
            return read_regular(where / _ORIGIN, 1 << 12).decode()
    return None


def local_folder(dataset: str | Path, *, fresh: bool = False) -> Path:
    """The folder to read a dataset from: itself, or the copy of a URL, brought up to date.

    fresh: shards that were fetched earlier are fetched again.
    Raises FactoryError when there is no dataset at the URL.
    """
    if not is_url(dataset):
        return Path(dataset)
    folder = folder_of(str(dataset))
    take_copy(folder, Store(str(dataset)).sizes(), fresh=fresh)
    if not (folder / "manifest.json").is_file():
        raise FactoryError(f"{dataset}: holds no manifest.json; give the URL of a dataset")
    return folder


def shown(folder: Path) -> str:
    """What to call a dataset's folder: by its URL where it is a copy."""
    return url_of(folder) or str(folder)


def take_copy(folder: Path, sizes: Mapping[str, int], *, fresh: bool) -> None:
    """Bring the small files of a copy up to date with the storage, and drop shards that differ."""
    store = Store(str(url_of(folder)))
    with explain_os_errors(folder, "SIMNFND_CLOUD_CACHE"):
        for path in [*folder.glob("*.*"), *folder.glob("t*/*")]:
            name = path.relative_to(folder).as_posix()
            differs = fresh or sizes.get(name) != path.stat().st_size
            if (_SMALL.fullmatch(name) and name not in sizes) or (
                _SHARD.fullmatch(name) and differs
            ):
                path.unlink(missing_ok=True)
        for name, size in sizes.items():
            if not _SMALL.fullmatch(name):
                continue
            if size > _MOST_SMALL_BYTES:
                raise FactoryError(f"{store.url}/{name}: {size} bytes are more than it can need")
            content = store.get(name)
            if content is not None:
                (folder / name).parent.mkdir(exist_ok=True)
                _write(folder / name, content)


def shard_names(names: Mapping[str, int]) -> list[str]:
    """Those of the names that are shards."""
    return [name for name in sorted(names) if _SHARD.fullmatch(name)]


def fetched(path: Path, look: Callable[[Path], None] | None = None) -> None:
    """Fetch the shard of a copy that is not here; who else wants it now waits for that.

    look: called with the file before it gets its name; what it raises leaves nothing behind.
    Nothing is done about any other file, or where the storage does not have it.
    """
    url = url_of(path.parent.parent)
    name = f"{path.parent.name}/{path.name}"
    if url is None or not _SHARD.fullmatch(name) or path.exists():
        return
    from filelock import FileLock

    with explain_os_errors(path, "SIMNFND_CLOUD_CACHE"):
        path.parent.mkdir(parents=True, exist_ok=True)
        number = zlib.crc32(path.name.encode()) % _LOCKS
        with FileLock(path.parent.parent / f".fetching-{number:02d}"):
            if not path.exists() and (content := Store(url).get(name)) is not None:
                _write(path, content, look)
                make_room(spare=path)


def most_bytes() -> int:
    """What all copies together may take.  Raises FactoryError when the variable is no number."""
    told = os.environ.get(_LIMIT, str(_KEPT_BYTES))
    try:
        return int(told)
    except ValueError as error:
        raise FactoryError(f"{_LIMIT}={told}: must be a whole number of bytes") from error


def make_room(spare: Path) -> None:
    """Remove shards of copies, the oldest first, until the rest is small enough.

    spare: the shard that came just now, which stays.
    """
    found = []
    for path in copies_folder().glob("*/t*/*.h5"):
        with suppress(OSError):
            state = path.stat()
            found.append((state.st_mtime_ns, state.st_size, path))
    total, most = sum(size for _, size, _ in found), most_bytes()
    for _, size, path in sorted(found):
        if total > most and path != spare:
            path.unlink(missing_ok=True)
            total -= size


def _write(path: Path, content: bytes, look: Callable[[Path], None] | None = None) -> None:
    aside = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    try:
        aside.write_bytes(content)
        if look:
            look(aside)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
