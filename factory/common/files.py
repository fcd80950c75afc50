"""Files that are wholly there or not at all: temp file, fsync, rename, fsync of the folder.

Writes into a folder of `forward_writes` are forwarded, too (`simnfnd.factory.storage`).
"""

from __future__ import annotations

import errno
import glob
import hashlib
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from .errors import FactoryError

_TEMPORARY = re.compile(r"\..+\.(?:[^.-]+-)?(?P<space>[0-9a-f]{8})-(?P<pid>\d+)-[0-9a-f]{16}\.tmp$")
_FOREIGN_STALE_S = 86_400.0
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def write_atomically(
    path: Path, content: bytes, *, durable: bool = True, key: str = "dataset.dir"
) -> None:
    """Write `content` to `path` so that a reader, a crash or a power cut never sees half a file.

    durable: wait until the disk has it; without, a power cut may leave half a file after all, which
        is for files that tell damage themselves.  key: named in the error.
    Raises FactoryError with one line when the folder cannot be written or the disk is full.
    """
    temporary = _temporary_for(path)
    with explain_os_errors(path, key):
        try:
            with open(temporary, "wb") as file:
                file.write(content)
                file.flush()
                if durable:
                    os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        if durable:
            sync_folder(path.parent)
    if durable:
        _forward_write(path, content)


def sync_folder(folder: Path) -> None:
    """Make renames inside `folder` survive a power cut; Windows opens no folders."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_stale_temporaries(folder: Path, name: str = "") -> None:
    """Delete temp files and folders of writers that are dead; leaves live writers alone.

    name: of the file or folder that they were to become; empty: any.
    """
    for path in folder.glob(f".{glob.escape(shortened(name))}.*.tmp" if name else ".*.tmp"):
        match = _TEMPORARY.match(path.name)
        if match is None:
            continue
        with suppress(FileNotFoundError):  # it was finished meanwhile
            # Another machine's or container's process cannot be looked up, only waited for.
            age_s = time.time() - path.stat().st_mtime
            is_ours = match["space"] == space()
            is_stale = is_dead(int(match["pid"])) if is_ours else age_s > _FOREIGN_STALE_S
            if is_stale and path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif is_stale:
                path.unlink()


def is_temporary(name: str) -> bool:
    """Whether a file name is that of one of our temp files."""
    return _TEMPORARY.match(name) is not None


def check_writable(folder: Path, key: str) -> None:
    """Create `folder` and write a byte into it, so that a run fails before its work, not after.

    `key` is the config key that the user would change; it opens the message of the FactoryError.
    """
    with explain_os_errors(folder, key):
        folder.mkdir(parents=True, exist_ok=True)
        probe = _temporary_for(folder / "probe")
        try:
            probe.write_bytes(b"\0")
        finally:
            probe.unlink(missing_ok=True)


def real_path(path: Path) -> Path:
    """The absolute path, links followed; of links in a circle the last one that can be.

    Path.resolve raises RuntimeError there.
    """
    return Path(os.path.realpath(path))


def sha256_of(path: Path) -> str:
    """Hex digest of a file's content, read in pieces."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def explain_os_errors(path: Path, key: str = "dataset.dir") -> Iterator[None]:
    """Turn an OSError about `path` into a FactoryError of one line that says what to do."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in _FULL:
            raise FactoryError(
                f"{path}: no room to write ({reason}); free some space and run the same command "
                "again, what is finished is kept"
            ) from error
        raise FactoryError(
            f"{key}: cannot write {path} ({reason}); give a writable folder with {key}="
        ) from error


def _temporary_for(path: Path) -> Path:
    # The token keeps apart what numbers do not: process 1 of containers that share a host name.
    name = shortened(path.name)
    return path.parent / f".{name}.{space()}-{os.getpid()}-{secrets.token_hex(8)}.tmp"


def shortened(name: str, most_bytes: int = 180) -> str:
    """A file name of at most this many bytes: file systems take 255, temporary files need some.

    What is cut off counts by its hash, so that different names stay different.
    """
    content = os.fsencode(name)
    if len(content) <= most_bytes:
        return name
    digest = hashlib.blake2b(content, digest_size=6).hexdigest()
    return f"{content[: most_bytes - len(digest) - 1].decode(errors='ignore')}~{digest}"


@cache
def space() -> str:
    """8 hexadecimal digits for where a process number means something.

    That is one boot of one machine, and there one name space of process numbers: containers that
    share a host name have process 1 each.
    """
    import socket  # which hardly any command needs

    machine = socket.gethostname()
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
        machine = boot + os.readlink("/proc/self/ns/pid")
    return hashlib.blake2b(machine.encode(), digest_size=4).hexdigest()


def is_dead(pid: int) -> bool:
    """Whether no process of this name space has that number, or one that waits to be collected."""
    import psutil  # only needed here, and readers of datasets have numpy and h5py alone

    with suppress(psutil.NoSuchProcess):
        # In a container whose first process reaps no children, dead processes stay as zombies.
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    return True


def refuse_files(folder: Path) -> None:
    """Raise FactoryError when `folder` is there and not empty."""
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise FactoryError(f"--out {folder}: holds files already; give a new or empty folder")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temp file to write, which takes the place of `path` at the end.

    When writing fails, nothing is left behind; what a killed process left goes first.
    Raises FactoryError when it cannot be written.
    """
    with explain_os_errors(path, "--out"):
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale_temporaries(path.parent, path.name)
        partial = _temporary_for(path)
        try:
            yield partial
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """An empty folder to fill, which becomes `folder` (absent or empty until then) at the end.

    When filling fails, nothing is left behind; what a killed process left goes first.
    Raises FactoryError when it cannot be written.
    """
    with explain_os_errors(folder, "--out"), temporary_folder(folder.absolute()) as partial:
        yield partial
        sync_folder(partial)
        os.replace(partial, folder)
        sync_folder(folder.absolute().parent)


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """An empty folder beside `path`, which is removed at the end.

    What a killed process left goes first.  Raises FactoryError when it cannot be written.
    """
    partial = _temporary_for(path)
    with explain_os_errors(path, "--out"):
        remove_stale_temporaries(path.parent, path.name)
        check_writable(partial, "--out")
        try:
            yield partial
        finally:
            shutil.rmtree(partial, ignore_errors=True)


# Folders of this process whose writes are forwarded, and the functions that forward them.
_forwarders: list[tuple[Path, Callable[[str, bytes | None], None]]] = []


@contextmanager
def forward_writes(folder: Path, forward: Callable[[str, bytes | None], None]) -> Iterator[None]:
    """Within the block, `forward` gets what this process writes into the folder, or removes.

    folder: absolute.  forward: called with the name below it and the content, None when the file
    was removed or found absent; raises FactoryError when it cannot pass that on.
    """
    _forwarders.append((folder, forward))
    try:
        yield
    finally:
        _forwarders.remove((folder, forward))


def remove_file(path: Path) -> None:
    """Remove a file, which may be absent, here and wherever it went."""
    path.unlink(missing_ok=True)
    _forward_write(path, None)


def _forward_write(path: Path, content: bytes | None) -> None:
    absolute = Path(os.path.abspath(path))
    for folder, forward in dict(_forwarders).items():
        if absolute.is_relative_to(folder):
            forward(absolute.relative_to(folder).as_posix(), content)
