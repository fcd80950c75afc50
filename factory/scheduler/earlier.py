"""The shards that an extended dataset began with: which samples each has, and what it states.

extended.json keeps that, because a damaged shard cannot be asked.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from ..dataset.format.manifest import Manifest, ShardInfo
from ..dataset.format.schema import SCHEMA, SPLITS, Provenance
from ..dataset.read.reader import reading
from ..dataset.write.folder import EXTENDED_NAME
from ..errors import FactoryError
from ..files import write_atomically
from ..frame import FrameRef
from ..small_files import parse_json, read_regular
from .plan import FrameVariants, ShardTask

_PATH = re.compile(rf"({'|'.join(SPLITS)})/shard-(\d{{5,}})\.h5")
_MOST_BYTES = 1 << 27
# Keys of a part of `extends` beside the settings in which it differs.
_ABOUT = ("config_hash", "samples")


@dataclass(frozen=True)
class Earlier:
    """A shard that was made before the extension.

    items: (frame, variants) in the order of its rows; the frames have no `paths`.
    config_hash: of the settings that it was made with.
    """

    path: str
    items: tuple[FrameVariants, ...]
    config_hash: str

    def __post_init__(self) -> None:
        if not _PATH.fullmatch(self.path):
            raise ValueError(f"{self.path!r} is no shard")

    @property
    def task(self) -> ShardTask:
        """The task that makes it, except for the paths of its frames."""
        split, number = _PATH.fullmatch(self.path).groups()  # type: ignore[union-attr]
        return ShardTask(split, int(number), self.items)


def read_earlier(directory: Path, info: ShardInfo, config_hash: str) -> Earlier:
    """Read which samples an undamaged shard has.  Raises FactoryError when it cannot be read."""
    if not _PATH.fullmatch(info.path):
        raise FactoryError(f"{directory / info.path}: not named like a shard of a run")
    with reading(directory / info.path) as file:
        table = file["meta"][()]
    names = ("location", "scene", "frame")
    rows = [(*(row[name].decode() for name in names), int(row["variant"])) for row in table]
    return Earlier(info.path, _grouped(rows), config_hash)


def earlier_shards(directory: Path, manifest: Manifest) -> tuple[Earlier, ...]:
    """The shards that the dataset of `manifest` extends; none if it extends nothing."""
    if "extends" not in manifest.config:
        return ()
    found = {shard.path: shard for shard in _load(directory, manifest.config_hash)}
    for path, info in manifest.shards.items():
        if path not in found and info.config_hash not in ("", manifest.config_hash):
            found[path] = read_earlier(directory, info, info.config_hash)
    return tuple(found[path] for path in sorted(found))


def save_earlier(directory: Path, earlier: Iterable[Earlier], config_hash: str) -> None:
    """Write extended.json, for the extension that is of `config_hash`."""
    shards = [
        {
            "path": shard.path,
            "config_hash": shard.config_hash,
            "items": [[r.location, r.scene, r.frame, list(v)] for r, v in shard.items],
        }
        for shard in earlier
    ]
    document = {"schema": SCHEMA, "config_hash": config_hash, "shards": shards}
    text = json.dumps(document, separators=(",", ":")) + "\n"
    write_atomically(directory / EXTENDED_NAME, text.encode())


def _load(directory: Path, config_hash: str) -> list[Earlier]:
    """The shards in extended.json; none when it is damaged, absent or of another extension."""
    try:
        document = parse_json(read_regular(directory / EXTENDED_NAME, _MOST_BYTES))
        if (document["schema"], document["config_hash"]) != (SCHEMA, config_hash):
            return []
        return [
            Earlier(
                str(shard["path"]),
                tuple(
                    (FrameRef(str(location), str(scene), str(frame)), tuple(map(int, variants)))
                    for location, scene, frame, variants in shard["items"]
                ),
                str(shard["config_hash"]),
            )
            for shard in document["shards"]
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _grouped(rows: Sequence[tuple[Any, ...]]) -> tuple[FrameVariants, ...]:
    """Rows (location, scene, frame, variant) as frames with their variants."""
    return tuple(
        (FrameRef(*name), tuple(row[3] for row in group))
        for name, group in groupby(rows, key=lambda row: row[:3])
    )


def parts(manifest: Manifest, config: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The `extends` of a dataset of `config` that extends the one of `manifest`, oldest first."""
    samples: dict[str, int] = {}
    for info in manifest.shards.values():
        hash_ = info.config_hash or manifest.config_hash
        samples[hash_] = samples.get(hash_, 0) + info.samples
    return [
        {
            "config_hash": hash_,
            "samples": samples.get(hash_, 0),
            **{key: value for key, value in old.items() if config.get(key) != value},
        }
        for hash_, old in _configs(manifest).items()
    ]


def provenances(manifest: Manifest, earlier: Iterable[Earlier]) -> dict[str, Provenance]:
    """Path -> what each earlier shard states, so that it can be made again to the byte."""
    configs = _configs(manifest)
    return {
        shard.path: Provenance(configs[shard.config_hash], shard.config_hash, manifest.generator)
        for shard in earlier
        if shard.config_hash in configs
    }


def _configs(manifest: Manifest) -> dict[str, dict[str, Any]]:
    """Config hash -> settings, of all that went into a dataset, the last one last."""
    last = {key: value for key, value in manifest.config.items() if key != "extends"}
    found = {
        str(part["config_hash"]): {
            **last,
            **{key: value for key, value in part.items() if key not in _ABOUT},
        }
        for part in manifest.config.get("extends", ())
    }
    return {**found, manifest.config_hash: last}
