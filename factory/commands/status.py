"""`simnfnd status DIR`: how far a dataset is, which frames failed, and another try of those."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ..cli import Parser
from ..dataset.folder import STATUS_NAME
from ..dataset.manifest import CONFIG_NAME, damage, load_failures, load_manifest
from ..dataset.schema import SPLITS
from ..errors import FactoryError
from ..scheduler.lock import owner_of
from ..small_files import load_yaml, one_line, parse_json, read_regular

if TYPE_CHECKING:
    from ..config import FactoryConfig


def main(words: list[str]) -> int:
    """Do what `words` ask for; 1 when a shard is damaged or, with --failed, a frame failed."""
    parser = Parser(prog="simnfnd status")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--verify", action="store_true", help="read every shard, too")
    what.add_argument("--failed", action="store_true", help="list the frames that failed, and why")
    what.add_argument(
        "--rerun",
        action="store_true",
        help="try them again, with the dataset's configuration; renders go to the cache",
    )
    parser.add_argument(
        "settings", nargs="*", metavar="KEY=VALUE",
        help="with --rerun: words of `simnfnd make` for scheduler and cache",
    )  # fmt: skip
    given = parser.parse_intermixed_args(words)
    if given.settings and not given.rerun:
        raise FactoryError(f"{given.settings[0]}: settings are for --rerun")
    failures = load_failures(given.dir)
    if given.rerun and failures:
        return _rerun(given.dir, [item["frame"] for item in failures], given.settings)
    if given.failed or given.rerun:
        return _list(given.dir, failures)
    return _state(given.dir, failures, verify=given.verify)


def _state(directory: Path, failures: Sequence[dict[str, str]], *, verify: bool) -> int:
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no dataset here (no manifest.json)")
    owner = owner_of(directory)
    running = f"process {owner['pid']} on {owner['host']} is at work" if owner else "nobody works"
    print(f"{directory}: {running}")
    for path in sorted(directory.glob(STATUS_NAME.replace(".", "*."))):
        with suppress(OSError, ValueError, KeyError, TypeError):
            print(_last_run(parse_json(read_regular(path)), owner is not None))
    shards = list(manifest.shards.values())
    for split in SPLITS:
        own = [shard for shard in shards if shard.split == split]
        size = sum(shard.bytes for shard in own) / 1e6
        pairs = sum(shard.samples for shard in own)
        print(f"  {split}: {pairs} pairs in {len(own)} shards, {size:.1f} MB")
    if failures:
        kinds = Counter(item["kind"] for item in failures)
        told = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
        print(f"  failed frames: {told} (`simnfnd status {directory} --failed` lists them)")
    problems = {shard.path: damage(directory, shard) for shard in shards} if verify else {}
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


def _list(directory: Path, failures: Sequence[dict[str, str]]) -> int:
    if not failures:
        if load_manifest(directory) is None:
            raise FactoryError(f"{directory}: no dataset here (no manifest.json)")
        print(f"{directory}: no frame failed")
        return 0
    for item in failures:
        print(_printable(f"{item['kind']}: {item['reason']}"))
        print(_printable(f"  {item['command']}"))
    print(f"{len(failures)} frames failed; running the dataset's command again tries them, too")
    return 1


def _rerun(directory: Path, failed: list[str], settings: list[str]) -> int:
    """Make the failed frames once more.  Nothing that the dataset's files say is executed."""
    from ..cli.generate import run

    frames = tuple(dict.fromkeys(failed))
    config = _stored(directory, settings)
    # What it renders goes to the cache.
    with TemporaryDirectory(prefix="simnfnd-") as retry:
        limits: dict[str, Any] = {"preview_pairs": 0, "max_train": None, "max_test": None}
        config = replace(
            config,
            frames=replace(config.frames, only=frames),
            dataset=replace(config.dataset, dir=retry, **limits),
        )
        try:
            run(config, arguments=settings)
        except FactoryError:
            # A run in which every frame failed ends like this, too, and has listed them.
            if not load_failures(Path(retry)):
                raise
        reasons = {item["frame"]: item["reason"] for item in load_failures(Path(retry))}
    for frame in frames:
        print(_printable(f"{frame}: {reasons.get(frame, 'works')}"))
    cured = sum(frame not in reasons for frame in frames)
    print(f"{cured} of {len(frames)} frames work now", end="")
    print("; run the dataset's command again to take them in" if cured else "")
    return 0 if cured == len(frames) else 1


def _stored(directory: Path, settings: list[str]) -> FactoryConfig:
    """What config.yaml says of the samples; scheduler and cache are those of `settings`.

    A dataset may come from a stranger, so it does not choose where renders are written or which
    cluster is connected to.
    """
    from ..cli.compose import compose_config
    from ..config import from_mapping

    path = directory / CONFIG_NAME
    try:
        values = load_yaml(path)
    except (OSError, ValueError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); restore it to rerun"
        ) from error
    if not isinstance(values, dict):
        raise FactoryError(f"{path}: not a configuration; restore it to rerun")
    here = compose_config(settings)
    own = {name: getattr(here, name) for name in ("scheduler", "cache", "shard", "debug")}
    try:
        return from_mapping({**values, **own})
    except FactoryError as error:
        raise FactoryError(f"{path}: {error}") from error


def _printable(text: str) -> str:
    """Without what a terminal would obey."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
