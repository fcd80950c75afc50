"""`simnfnd cache stats|verify|pack|clear`: the renders that are kept on disk."""

from __future__ import annotations

import time
from pathlib import Path

from ..cli import Parser
from ..cli.compose import compose_config
from ..errors import FactoryError
from ..render.views import Cache

_EPILOG = (
    "KEY=VALUE words are those of `simnfnd make`; cache.dir is the one that matters to stats, "
    "verify and clear, and for pack all that choose the frames and their render."
)


def main(words: list[str]) -> int:
    """Do what `words` ask for; returns the exit code (1: verify found damage)."""
    parser = Parser(prog="simnfnd cache", epilog=_EPILOG)
    parser.add_argument(
        "action",
        choices=("stats", "verify", "pack", "clear"),
        help="how many there are and how large; remove damaged ones; the renders of a "
        "configuration in one file, for a machine without Blender; remove all",
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, help="pack: file to write, for example views.pack")
    given = parser.parse_intermixed_args(words)
    if given.action == "pack":
        return _pack(given.overrides, given.out)
    if given.out:
        raise FactoryError(f"cache {given.action}: --out is for cache pack")
    cache = Cache(compose_config(given.overrides).cache.folder)
    if given.action == "clear":
        print(f"cache: {cache.clear()} renders removed from {cache.folder}")
        return 0
    return _stats(cache) if given.action == "stats" else _verify(cache)


def _stats(cache: Cache) -> int:
    entries = list(cache.entries())
    size = sum(entry.bytes for entry in entries)
    print(f"cache: {cache.folder}: {len(entries)} renders, {size / 1e6:.1f} MB")
    if entries:
        times = [entry.used_ns / 1e9 for entry in entries]
        day = [time.strftime("%Y-%m-%d %H:%M", time.localtime(t)) for t in (min(times), max(times))]
        print(f"cache: {size / len(entries) / 1e3:.0f} kB each, last used {day[0]} to {day[1]}")
    return 0


def _verify(cache: Cache) -> int:
    entries = list(cache.entries())
    damaged = [entry for entry in entries if cache.get(entry.key, used=False) is None]
    for entry in damaged:
        print(f"cache: {entry.path}: damaged and removed; it is rendered again when it is needed")
    print(f"cache: {len(entries) - len(damaged)} of {len(entries)} renders are whole")
    return 1 if damaged else 0


def _pack(overrides: list[str], out: Path | None) -> int:
    from ..render.pack import write_pack
    from ..render.views import CachedViews
    from ..scenes import open_reader
    from ..selection import choose_frames

    if out is None:
        raise FactoryError("cache pack: which file? give --out FILE")
    config = compose_config(overrides)
    if config.scenes.kind == "pack":
        raise FactoryError("cache pack: scenes=pack is a pack already; copy its file")
    refs = choose_frames(open_reader(config.scenes).discover().frames, config)
    views = CachedViews(config)
    there = [ref for ref in refs if views.holds(ref)]
    missing = len(refs) - len(there)
    if not there:
        raise FactoryError(
            f"cache pack: none of the {len(refs)} frames is rendered in {config.cache.folder}; "
            f"run `simnfnd make {' '.join(overrides)}` first"
        )
    classes = config.scenes.own_classes()
    size = write_pack(out, there, views.view, config.sonar.mount, config.render.kind, classes)
    print(f"pack: {out}: {len(there)} frames, {size / len(there) / 1e3:.0f} kB each")
    if missing:
        print(f"pack: {missing} frames are not rendered yet and left out")
    return 0
