"""How much of the disk local copies may take, and which of them go when they take more."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

from ..errors import FactoryError

_KEPT_BYTES = 10_000_000_000
_LIMIT = "SIMNFND_CLOUD_CACHE_BYTES"


def copies_folder() -> Path:
    """Where the copies are: SIMNFND_CLOUD_CACHE, or the user's folder for caches."""
    if told := os.environ.get("SIMNFND_CLOUD_CACHE"):
        return Path(told).absolute()
    base = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(base).absolute() / "simnfnd" / "cloud"


def most_bytes() -> int:
    """What all copies together may take.  Raises FactoryError when the variable is no number."""
    told = os.environ.get(_LIMIT, str(_KEPT_BYTES))
    try:
        return int(told)
    except ValueError as error:
        raise FactoryError(f"{_LIMIT}={told}: must be a whole number of bytes") from error


def sure_bytes() -> int:
    """So much of what was used last stays, whatever comes."""
    most = most_bytes()
    return most - most // 16


def touch(path: Path) -> bool:
    """Note that a shard is in use, so that others go first; returns whether it is there.

    By its time of access alone: the time of change tells whether it is the file that it was.
    """
    try:
        os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
    except OSError:
        return path.exists()
    return True


def make_room(spare: Path) -> None:
    """Remove shards of copies, those not used for longest first, until the rest is small enough.

    spare: the shard that came just now, which stays.  A look at all copies takes a time that grows
    with their number, so this process takes the next one when a sixteenth of what was free has
    come, or a sixty-fourth of the limit; others beside it may go beyond the limit by as much.
    """
    most = most_bytes()
    where = copies_folder(), most
    with suppress(OSError):
        _to_come[where] = _to_come.get(where, 0) - spare.stat().st_size
    if _to_come.get(where, -1) >= 0:
        return
    found = _kept_copies(where[0])
    total = sum(size for _, size, _ in found)
    # A little more than has to go, so that the next look is not at once.
    wanted = sure_bytes() if total > most else most
    for _, size, path in sorted(found):
        if total <= wanted:
            break
        if path != spare:
            path.unlink(missing_ok=True)
            total -= size
    free = max(most - total, 0)
    _to_come[where] = max(free // 16, min(free, most // 64))


# (folder of copies, limit) -> bytes that may come before all copies are looked at again.
_to_come: dict[tuple[Path, int], int] = {}


def _kept_copies(folder: Path) -> list[tuple[int, int, Path]]:
    """(when it was used last, bytes, path) of every shard of every copy."""
    found = []
    for path in folder.glob("*/t*/*.h5"):
        with suppress(OSError):
            state = path.stat()
            found.append((state.st_atime_ns, state.st_size, path))
    return found
