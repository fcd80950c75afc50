"""Datasets on storage that is no disk: objects at a URL that fsspec reaches, and local copies.

A copy is a folder like any dataset's, so that whatever reads a dataset reads it: small files come
at once, shards when they are asked for.  The oldest shards go when all copies together take more
than SIMNFND_CLOUD_CACHE_BYTES.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..common.errors import FactoryError
from ..common.files import explain_os_errors, write_atomically
from ..common.small_files import read_regular

_URL = re.compile(r"([a-z][a-z0-9+.-]*)://(.+)")
# What is written there can be seen half finished.
_FILES = ("file", "local", "ssh", "sftp", "ftp", "smb")
_ORIGIN = ".origin"
SHARD_NAME = re.compile(r"(train|test)/[A-Za-z0-9_-]+\.h5")
# What lies beside the shards and is a reader's business.
_SMALL = re.compile(
    r"README\.md|config\.yaml|index\.h5|preview\.png|failed\.jsonl|manifest\.json"
    r"|(train|test)/shard-\d+\.json"
)
_FOLDER = "SIMNFND_CLOUD_CACHE"
_LIMIT = "SIMNFND_CLOUD_CACHE_BYTES"
_KEPT_BYTES = 10_000_000_000


def is_url(name: object) -> bool:
    """Whether a name is a URL of a storage, and no path."""
    return isinstance(name, str) and _URL.fullmatch(name) is not None


@dataclass(frozen=True)
class Store:
    """The objects below `url`, put whole and got whole; names are relative, with forward slashes.

    Every method raises FactoryError, one line, when the storage refuses or cannot be reached.
    Credentials and addresses are the library's own matter: AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL,
    ~/.aws, or what fsspec's configuration says.
    """

    url: str

    def __post_init__(self) -> None:
        match = _URL.fullmatch(self.url)
        if match is None or match[1] in _FILES or re.search(r"::|\?|#", self.url):
            raise FactoryError(
                f"{self.url}: no URL of objects, such as s3://bucket/folder; of files, mount it, "
                "give a folder"
            )
        object.__setattr__(self, "url", self.url.rstrip("/"))

    def sizes(self) -> dict[str, int]:
        """Name -> bytes of every object."""
        with self._place("read") as (system, root):
            system.invalidate_cache()
            return {
                name[len(root) :].lstrip("/"): int(entry["size"] or 0)
                for name, entry in system.find(root, detail=True).items()
            }

    def get(self, name: str) -> bytes | None:
        """The content of an object; None when there is none."""
        with self._place("read", name) as (system, root), suppress(FileNotFoundError):
            return bytes(system.cat_file(f"{root}/{name}"))
        return None

    def put(self, name: str, content: bytes) -> None:
        """Write an object; readers see the old one or the new one, and never a part."""
        with self._place("written", name) as (system, root):
            system.pipe_file(f"{root}/{name}", content)

    def create(self, name: str, content: bytes) -> bool:
        """Write an object that is not there yet; returns whether it was not.

        Of two that try at once one succeeds.
        """
        with self._place("written", name) as (system, root), suppress(FileExistsError):
            system.pipe_file(f"{root}/{name}", content, mode="create")
            return True
        return False

    def remove(self, name: str) -> None:
        """Remove an object, which may be absent."""
        with self._place("removed", name) as (system, root), suppress(FileNotFoundError):
            system.rm_file(f"{root}/{name}")

    @contextmanager
    def _place(self, done: str, name: str = "") -> Iterator[tuple[Any, str]]:
        """File system, of which fsspec keeps one for each process and thread, and root."""
        try:
            import fsspec

            system, root = fsspec.core.url_to_fs(self.url)
            yield system, str(root).rstrip("/")
        # Each storage's library has errors of its own.
        except Exception as error:
            address = f"{self.url}/{name}" if name else self.url
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise FactoryError(
                f"{address}: cannot be {done} ({reason}); check the address, the credentials, the "
                "network and the packages (S3: simnfnd[cloud]), and run the same command again"
            ) from error


def copies_folder() -> Path:
    """Where the copies are: SIMNFND_CLOUD_CACHE, or the user's folder for caches."""
    base = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(os.environ.get(_FOLDER) or Path(base) / "simnfnd" / "cloud").absolute()


def folder_of(url: str, part: str = "") -> Path:
    """The folder of a dataset's copy; made, and known as that copy.

    part: of a run that makes a slice: runs side by side have copies of their own.
    """
    store = Store(url)
    digest = hashlib.blake2b(f"{store.url}\n{part}".encode(), digest_size=6).hexdigest()
    name = re.sub(r"[^A-Za-z0-9_-]", "_", store.url.rpartition("/")[2])[:40]
    folder = copies_folder() / f"{name}-{digest}"
    with explain_os_errors(folder, _FOLDER):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / _ORIGIN, store.url.encode(), durable=False, key=_FOLDER)
    return folder


def url_of(folder: Path) -> str | None:
    """The URL that `folder` is a copy of; None for any other folder.

    Only of our own place for copies: an untrusted dataset cannot direct us elsewhere.
    """
    copy = Path(os.path.abspath(folder))
    if copy.parent == copies_folder():
        with suppress(OSError, ValueError):
            return read_regular(copy / _ORIGIN).decode()
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
    with explain_os_errors(folder, _FOLDER):
        for path in [*folder.glob("*.*"), *folder.glob("t*/*")]:
            name = path.relative_to(folder).as_posix()
            differs = fresh or sizes.get(name) != path.stat().st_size
            is_removed = _SMALL.fullmatch(name) and name not in sizes
            if is_removed or (SHARD_NAME.fullmatch(name) and differs):
                path.unlink(missing_ok=True)
        for name in filter(_SMALL.fullmatch, sizes):
            if (content := store.get(name)) is not None:
                (folder / name).parent.mkdir(exist_ok=True)
                write_atomically(folder / name, content, durable=False, key=_FOLDER)


def fetched(path: Path, check: Callable[[Path], None] = lambda aside: None) -> None:
    """Fetch the shard of a copy that is not here; who else wants it now waits for that.

    check: called with the file before it gets its name; what it raises leaves nothing behind.
    Nothing is done about any other file, or where the storage does not have it.
    """
    url = url_of(path.parent.parent)
    name = f"{path.parent.name}/{path.name}"
    if url is None or not SHARD_NAME.fullmatch(name) or path.exists():
        return
    from filelock import FileLock

    aside = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    with explain_os_errors(path, _FOLDER):
        path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(path.with_suffix(".lock")):
            if path.exists() or (content := Store(url).get(name)) is None:
                return
            try:
                aside.write_bytes(content)
                check(aside)
                os.replace(aside, path)
            finally:
                aside.unlink(missing_ok=True)
            make_room(spare=path)


def make_room(spare: Path) -> None:
    """Remove shards of copies, the oldest first, until the rest is small enough.

    spare: the shard that came just now, which stays.
    Raises FactoryError when SIMNFND_CLOUD_CACHE_BYTES is no number.
    """
    limit_text = os.environ.get(_LIMIT, str(_KEPT_BYTES))
    if not limit_text.isdecimal():
        raise FactoryError(f"{_LIMIT}={limit_text}: must be a whole number of bytes")
    shards = []
    for path in copies_folder().glob("*/t*/*.h5"):
        with suppress(OSError):
            state = path.stat()
            shards.append((state.st_mtime_ns, state.st_size, path))
    total = sum(size for _, size, _ in shards)
    for _, size, path in sorted(shards):
        if total > int(limit_text) and path != spare:
            path.unlink(missing_ok=True)
            total -= size
