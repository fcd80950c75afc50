"""A place on a storage, by its URL: named objects that are put whole and got whole."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from ..errors import FactoryError

_URL = re.compile(r"([a-z][a-z0-9+.-]*)://(.+)")
# What is written there can be seen half finished.
_FILES = ("file", "local", "ssh", "sftp", "ftp", "smb")


def is_url(name: object) -> bool:
    """Whether a name is a URL of a storage, and no path."""
    return isinstance(name, str) and _URL.fullmatch(name) is not None


@dataclass(frozen=True)
class Store:
    """The objects below `url`; names are relative to it, with forward slashes.

    Every method raises FactoryError, one line, when the storage refuses or cannot be reached.
    Credentials and addresses are the library's own matter: AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL,
    ~/.aws, or what fsspec's configuration says.
    """

    url: str

    def __post_init__(self) -> None:
        match = _URL.fullmatch(self.url)
        if match is None or "::" in self.url or "?" in self.url or "#" in self.url:
            raise FactoryError(f"{self.url}: no URL of a storage, such as s3://bucket/folder")
        if match[1] in _FILES:
            raise FactoryError(f"{self.url}: objects are stored, no files; mount it, give a folder")
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

        Of two that try at once one succeeds.  Raises FactoryError where the storage cannot tell.
        """
        with self._place("written", name) as (system, root):
            try:
                system.pipe_file(f"{root}/{name}", content, mode="create")
            except FileExistsError:
                return False
            except (NotImplementedError, TypeError, ValueError) as error:
                raise FactoryError(
                    f"{self.url}: this storage cannot write an object only where there is none, so "
                    "nothing would keep two runs apart; make the dataset in a folder and copy it"
                ) from error
            return True

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
        except FactoryError:
            raise
        except ImportError as error:
            raise FactoryError(
                f"{self.url}: needs another package ({error}); S3: pip install 'simnfnd[cloud]'"
            ) from error
        # Each storage's library has errors of its own.
        except Exception as error:
            where = f"{self.url}/{name}" if name else self.url
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise FactoryError(
                f"{where}: cannot be {done} ({reason}); look at the address, the credentials and "
                "the network, and run the same command again"
            ) from error
