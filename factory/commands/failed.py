"""`simnfnd failed DIR`: the frames that gave no sample, why, and another try."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..cli import Parser
from ..dataset.format.manifest import CONFIG_NAME, load_manifest
from ..dataset.write.failures import FAILURES_NAME, load_failures
from ..errors import FactoryError
from ..small_files import load_yaml, one_line

if TYPE_CHECKING:
    from ..config import FactoryConfig


def main(words: list[str]) -> int:
    """List the failures, or try them again; returns 0 when there are none (any more), else 1."""
    parser = Parser(prog="simnfnd failed")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    parser.add_argument(
        "settings",
        nargs="*",
        metavar="KEY=VALUE",
        help="with --rerun: words of `simnfnd make` for scheduler and cache",
    )
    parser.add_argument(
        "--rerun",
        action="store_true",
        help="try the frames again, with the configuration in the dataset, in a folder DIR-retry",
    )
    given = parser.parse_intermixed_args(words)
    if given.settings and not given.rerun:
        raise FactoryError(f"{given.settings[0]}: settings are for --rerun")
    failures = load_failures(given.dir)
    if load_manifest(given.dir) is None and not failures:
        raise FactoryError(f"{given.dir}: no dataset here (no manifest.json)")
    if not failures:
        print(f"{given.dir}: no frame failed")
        return 0
    if given.rerun:
        return _rerun(given.dir, [item["frame"] for item in failures], given.settings)
    for item in failures:
        print(_printable(f"{item['kind']}: {item['reason']}"))
        print(_printable(f"  {item['command']}"))
    print(f"{len(failures)} frames failed; running the dataset's command again tries them, too")
    return 1


def _rerun(directory: Path, failed: list[str], settings: list[str]) -> int:
    """Make the failed frames once more.  Nothing that the dataset's files say is executed."""
    from ..cli.generate import run

    frames = tuple(dict.fromkeys(failed))
    retry = Path(f"{directory}-retry")
    config = _stored(directory, settings)
    config = replace(
        config,
        frames=replace(config.frames, only=frames),
        dataset=replace(
            config.dataset,
            dir=str(retry),
            on_existing="overwrite",
            preview_pairs=0,
            max_train=None,
            max_test=None,
        ),
    )
    if load_manifest(retry) is not None:
        (retry / FAILURES_NAME).unlink(missing_ok=True)
    try:
        run(config, arguments=settings)
    except FactoryError:
        # A run in which every frame failed ends like this, too, and has listed them.
        if not load_failures(retry):
            raise
    reasons = {item["frame"]: item["reason"] for item in load_failures(retry)}
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
    try:
        config = from_mapping(values)
    except FactoryError as error:
        raise FactoryError(f"{path}: {error}") from error
    here = compose_config(settings)
    return replace(
        config, scheduler=here.scheduler, cache=here.cache, shard=here.shard, debug=here.debug
    )


def _printable(text: str) -> str:
    """Without what a terminal would obey."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
