"""`simnfnd status DIR`: how far a dataset is, which frames failed, and another try of those."""

from __future__ import annotations

import shlex
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ...common.command_line import Parser
from ...common.errors import FactoryError
from ...common.small_files import parse_json, read_regular
from ...dataset.folder import STATUS_NAME
from ...dataset.manifest import Manifest, load_failures, load_manifest
from ...dataset.schema import SPLITS
from ..scheduler.lock import owner_of

_LEAST_PER_SECOND = 0.1


def main(words: list[str]) -> int:
    """Do what `words` ask for; 1 when, with --failed or --rerun, a frame failed."""
    parser = Parser(prog="simnfnd status")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    modes = parser.add_mutually_exclusive_group()
    modes.add_argument("--failed", action="store_true", help="list the frames that failed, and why")
    modes.add_argument(
        "--rerun",
        action="store_true",
        help="try the failed frames again, with the dataset's configuration; their renders go to "
        "the cache",
    )
    parser.add_argument(
        "settings", nargs="*", metavar="KEY=VALUE",
        help="with --rerun: words of `simnfnd make` for scheduler and cache",
    )  # fmt: skip
    arguments = parser.parse_intermixed_args(words)
    failures = load_failures(arguments.dir)
    if arguments.rerun and failures:
        return _rerun(arguments.dir, [item["frame"] for item in failures], arguments.settings)
    manifest = load_manifest(arguments.dir)
    if manifest is None:
        raise FactoryError(f"{arguments.dir}: no dataset here (no manifest.json)")
    if arguments.failed or arguments.rerun:
        for item in failures:
            print(_printable(f"{item['kind']}: {item['reason']}"))
            print(_printable(f"  {item['command']}"))
        print(f"{len(failures)} frames failed", end="")
        print("; running the dataset's command again tries them, too" if failures else "")
        return 1 if failures else 0
    _state(arguments.dir, manifest, len(failures))
    return 0


def _state(directory: Path, manifest: Manifest, failed: int) -> None:
    """Print who works on a dataset, its last runs, and what is there."""
    owner = owner_of(directory)
    running = "no worker is running"
    if owner:
        running = f"process {owner['pid']} on {owner['host']} is running"
    print(f"{directory}: {running}")
    for path in sorted(directory.glob(STATUS_NAME.replace(".", "*."))):
        with suppress(OSError, ValueError, KeyError, TypeError):
            print(_last_run(parse_json(read_regular(path)), owner is not None))
    for split in SPLITS:
        own = manifest.of_split(split)
        size = sum(shard.bytes for shard in own) / 1e6
        print(f"  {split}: {manifest.samples(split)} pairs in {len(own)} shards, {size:.1f} MB")
    if failed:
        quoted = shlex.quote(str(directory))
        print(f"  {failed} frames failed (`simnfnd status {quoted} --failed` lists them)")


def _last_run(status: dict[str, Any], at_work: bool) -> str:
    state = status["state"]
    pairs = status["pairs"]
    frames = status["frames"]
    if state == "running" and not at_work:
        state = "killed; run the same command again to go on"
    line = f"  last run: {state}; {pairs['done']} of {pairs['total']} pairs, "
    line += _rate_text(status["pairs_per_second"])
    if frames["total"]:
        line += f"; frames: {frames['rendered']} rendered, {frames['from_cache']} from the cache"
    if at_work and status["seconds_left"] is not None:
        line += f"; {status['seconds_left']} s left"
    return line


def _rate_text(pairs_per_s: float) -> str:
    """Such as `2.50 pairs per second`; per hour where that would say 0.00."""
    if pairs_per_s >= _LEAST_PER_SECOND:
        return f"{pairs_per_s:.2f} pairs per second"
    return f"{3600 * pairs_per_s:.1f} pairs per hour" if pairs_per_s else "none in its time"


def _rerun(directory: Path, failed: list[str], settings: list[str]) -> int:
    """Make the failed frames once more.  Nothing that the dataset's files say is executed."""
    from ...simulation.config.compose import compose_config
    from ...simulation.config.stored import stored_config
    from ..cli.generate import run

    frames = tuple(dict.fromkeys(failed))
    config = stored_config(directory, compose_config(settings))
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


def _printable(text: str) -> str:
    """The text without characters that a terminal would obey."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
