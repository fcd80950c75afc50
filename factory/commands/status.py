"""`simnfnd status DIR`: how far a dataset is, whether anybody works on it."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..cli import Parser
from ..dataset.format.manifest import damage, load_manifest
from ..dataset.format.schema import SPLITS
from ..dataset.write.failures import load_failures
from ..dataset.write.folder import STATUS_NAME, slice_manifests
from ..errors import FactoryError
from ..scheduler.lock import owner_of
from ..small_files import parse_json, read_regular


def main(words: list[str]) -> int:
    """Print the state of a dataset; returns 0, or 1 when a shard is damaged."""
    parser = Parser(prog="simnfnd status")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    parser.add_argument("--verify", action="store_true", help="read every shard, too")
    given = parser.parse_args(words)
    directory: Path = given.dir
    whole = load_manifest(directory)
    manifests = [whole] if whole else list(slice_manifests(directory))
    if not manifests:
        raise FactoryError(f"{directory}: no dataset here (no manifest.json)")
    owner = owner_of(directory)
    running = f"process {owner['pid']} on {owner['host']} is at work" if owner else "nobody works"
    print(f"{directory}: {running}")
    for path in sorted(directory.glob(STATUS_NAME.replace(".", "*."))):
        with suppress(OSError, ValueError, KeyError, TypeError):
            print(_last_run(parse_json(read_regular(path)), owner is not None))
    shards = [shard for manifest in manifests for shard in manifest.shards.values()]
    for split in SPLITS:
        own = [shard for shard in shards if shard.split == split]
        size = sum(shard.bytes for shard in own) / 1e6
        pairs = sum(shard.samples for shard in own)
        print(f"  {split}: {pairs} pairs in {len(own)} shards, {size:.1f} MB")
    kinds = Counter(item["kind"] for item in load_failures(directory))
    if kinds:
        told = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
        print(f"  failed: {told} (see `simnfnd failed {directory}`)")
    if not given.verify:
        return 0
    problems = {shard.path: damage(directory, shard) for shard in shards}
    for name, problem in problems.items():
        if problem:
            print(f"  {name}: {problem}; run the same command again to repair it")
    return 1 if any(problems.values()) else 0


def _last_run(told: dict[str, Any], at_work: bool) -> str:
    state = told["state"]
    if state == "running" and not at_work:
        state = "killed; run the same command again to go on"
    pairs, frames = told["pairs"], told["frames"]
    line = f"  last run: {state}; {pairs['done']} of {pairs['total']} pairs, "
    line += f"{told['pairs_per_second']:.2f} a second"
    if frames["total"]:
        line += f"; frames: {frames['rendered']} rendered, {frames['from_cache']} from the cache"
    if at_work and told["seconds_left"] is not None:
        line += f"; {told['seconds_left']} s left"
    return line
