"""SQLite bags of ROS 2 that are cut short: the rows whose pages are all there.

SQLite refuses a file that is shorter than its header says.  Here it sees zeros where pages are
missing, and the rows are read in their order up to the first that is damaged.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .cut_bags import StoredMessage

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_MAGIC = b"SQLite format 3\0"
_LINK_BYTES = 4  # of an overflow page, which name the next one
_NAME = "simnfnd-cut-database"


class CutDatabase:
    """A reader of a `.db3` file that is cut short, as those of rosbags are.

    connections: of the topics, with how many messages each has.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.connections: list[Connection] = []

    def open(self) -> None:
        """Counts the whole messages.  May raise nearly anything."""
        from rosbags.interfaces import (
            Connection,
            ConnectionExtRosbag2,
            MessageDefinition,
            MessageDefinitionFormat,
        )

        counts: dict[int, int] = {}
        for topic, _, _ in self._rows():
            counts[topic] = counts.get(topic, 0) + 1
        database = self._opened()
        query = "SELECT id, name, type, serialization_format FROM topics"
        self.connections = [
            Connection(
                number,
                name,
                kind,
                MessageDefinition(MessageDefinitionFormat.NONE, ""),
                "",
                counts[number],
                ConnectionExtRosbag2(encoding, []),
                None,
            )
            for number, name, kind, encoding in database.execute(query)
            if number in counts
        ]
        database.close()

    def messages(self, connections: Collection[Connection]) -> Iterator[StoredMessage]:
        """The messages of these connections, in order."""
        wanted = {connection.id: connection for connection in connections}
        for topic, time_ns, content in self._rows():
            if topic in wanted:
                yield StoredMessage(wanted[topic], time_ns, content)

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def _rows(self) -> Iterator[tuple[int, int, bytes]]:
        """Topic, nanoseconds since 1970 and content of each whole message."""
        import apsw

        database = self._opened()
        page_bytes, _ = _sizes_of(self._path)
        query = "SELECT topic_id, timestamp, data FROM messages ORDER BY rowid"
        last: tuple[int, int, bytes] | None = None
        try:
            for row in database.execute(query):
                if last is not None:
                    yield last
                last = row
        except apsw.Error:
            # The last page of the last row may be one of the zeros.
            tail = -(page_bytes - _LINK_BYTES)
            if last is not None and not any(last[2][tail:]):
                last = None
        if last is not None:
            yield last
        database.close()

    def _opened(self) -> Any:
        import apsw

        page_bytes, pages = _sizes_of(self._path)
        _ZeroFilled.register(page_bytes * pages)
        flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
        return apsw.Connection(f"{self._path.absolute().as_uri()}?immutable=1", flags, vfs=_NAME)


class _ZeroFilled:
    """The file system in which a file is as long as its header says, and zero where it ends."""

    @staticmethod
    def register(length: int) -> None:
        """Makes it known to SQLite; the last one that is registered counts."""
        import apsw

        class File(apsw.VFSFile):
            def __init__(self, name: Any, flags: list[int]) -> None:
                super().__init__("", name, flags)
                self._file = Path(name.filename()).open("rb")  # noqa: SIM115 (closed by SQLite)

            def xFileSize(self) -> int:
                return length

            def xRead(self, amount: int, offset: int) -> bytes:
                self._file.seek(offset)
                return self._file.read(amount).ljust(amount, b"\0")

            def xClose(self) -> None:
                self._file.close()
                super().xClose()

        class System(apsw.VFS):
            def __init__(self) -> None:
                super().__init__(_NAME, "")

            def xOpen(self, name: Any, flags: list[int]) -> Any:
                return File(name, flags) if name is not None else super().xOpen(name, flags)

        _ZeroFilled.system = System()  # type: ignore[attr-defined]


def _sizes_of(path: Path) -> tuple[int, int]:
    """Bytes of a page, and pages, as the header says (https://sqlite.org/fileformat.html)."""
    with path.open("rb") as file:
        header = file.read(100)
    if header[:16] != _MAGIC:
        raise ValueError("no database of SQLite")
    page_bytes = int.from_bytes(header[16:18], "big")
    return 65536 if page_bytes == 1 else page_bytes, int.from_bytes(header[28:32], "big")
