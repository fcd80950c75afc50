"""One finished shard, as manifest.json and the results beside shards list it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .schema import SPLITS

_PATH = re.compile(rf"({'|'.join(SPLITS)})/[A-Za-z0-9_-]+\.h5")


@dataclass(frozen=True)
class ShardInfo:
    """One finished shard.

    path: below the dataset's folder, with forward slashes.
    plan: digest of the frames and variants that the shard was meant to hold.
    failed: names of the planned frames that it lacks.
    config_hash: of the settings that it was made with; empty: those of the manifest.
    """

    path: str
    split: str
    samples: int
    bytes: int
    sha256: str
    plan: str = ""
    failed: tuple[str, ...] = ()
    config_hash: str = ""

    def __post_init__(self) -> None:
        counts = (self.samples, self.bytes)
        texts = (self.path, self.split, self.sha256, self.plan, self.config_hash, *self.failed)
        if not all(type(count) is int and count >= 0 for count in counts):
            raise ValueError(f"samples and bytes must be counts, got {counts}")
        # Every sample takes some bytes: no count may be what no file can hold.
        if self.samples > self.bytes:
            raise ValueError(f"{self.samples} samples in {self.bytes} bytes")
        if not all(isinstance(text, str) for text in texts):
            raise ValueError("path, split, sha256, plan, failed and config_hash must be text")
        # Nothing outside the dataset's folder may be named, whoever wrote the file.
        if not _PATH.fullmatch(self.path) or self.path.split("/")[0] != self.split:
            raise ValueError(f"{self.path!r} is no shard of split {self.split!r}")


def shard_info(item: Mapping[str, Any]) -> ShardInfo:
    """The shard that plain values tell of.  Raises ValueError, KeyError or TypeError for others."""
    return ShardInfo(**{**item, "failed": tuple(item.get("failed", ()))})
