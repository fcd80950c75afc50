"""Is a shard the one that the manifest lists?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py

from ...errors import FactoryError
from ...files import sha256_of
from ..format.manifest import ShardInfo
from .reader import check_split


@dataclass(frozen=True)
class Expected:
    """Refuses a shard that is not the one that the manifest listed when the dataset was opened.

    hashed: the shards whose SHA-256 was compared; None when that is not asked for.
    """

    root: Path
    shards: dict[Path, ShardInfo]
    hashed: set[Path] | None

    def __call__(self, path: Path, file: h5py.File) -> None:
        """Raises FactoryError when it is another one, or of the other split."""
        info = self.shards.get(path)
        if info and self.hashed is not None and path not in self.hashed:
            if sha256_of(path) != info.sha256:
                raise FactoryError(
                    f"{path}: SHA-256 differs from the manifest's; run the command that made the "
                    "dataset again"
                )
            self.hashed.add(path)
        found = (len(file["noisy"]), path.stat().st_size)
        if info and found != (info.samples, info.bytes):
            raise FactoryError(
                f"{path}: {found[0]} samples in {found[1]} bytes, the manifest said "
                f"{info.samples} in {info.bytes}; open the dataset again if it was being extended, "
                "otherwise generate the shard again"
            )
        check_split(path, file)
