"""`simnfnd cache stats|pack|clear`: the renders that are kept on disk."""

from __future__ import annotations

from pathlib import Path

from ...common.command_line import Parser
from ...common.errors import FactoryError
from ...common.files import explain_os_errors
from ...common.words import shell_line
from ...simulation.config.compose import compose_config
from ...simulation.config.renderer_choice import renderer_of
from ...simulation.pairs.views import Cache, CachedViews


def main(words: list[str]) -> None:
    """Count, pack or delete renders, as `words` say."""
    parser = Parser(
        prog="simnfnd cache",
        epilog="stats and clear use cache.dir alone; pack uses all keys that choose frames and "
        "their render.",
    )
    parser.add_argument(
        "action",
        choices=("stats", "pack", "clear"),
        help="stats: count the renders; pack: write the renders of a configuration to one file, "
        "for a machine without Blender; clear: delete all renders",
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as for `simnfnd make`")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="pack: file to write, for example views.pack"
    )
    arguments = parser.parse_intermixed_args(words)
    if arguments.action == "pack":
        _pack(arguments.overrides, arguments.out)
        return
    cache = Cache(compose_config(arguments.overrides).cache)
    entries = cache.entries()
    size_mb = sum(size for _, _, size in entries) / 1e6
    if arguments.action == "clear":
        with explain_os_errors(cache.folder, "cache.dir"):
            for _, path, _ in entries:
                path.unlink(missing_ok=True)
    removed = " removed" if arguments.action == "clear" else ""
    print(f"cache: {cache.folder}: {len(entries)} renders{removed}, {size_mb:.1f} MB")


def _pack(overrides: list[str], out: Path | None) -> None:
    from ...simulation.config.selection import choose_frames
    from ...simulation.render.pack import write_pack
    from ...simulation.scenes import open_reader

    if out is None:
        raise FactoryError("cache pack: which file? give --out FILE")
    config = compose_config(overrides)
    refs = choose_frames(open_reader(config.scenes).discover().frames, config)
    views = CachedViews(config)
    held = [ref for ref in refs if views.holds(ref)]
    if not held:
        raise FactoryError(
            f"cache pack: none of the {len(refs)} frames is rendered in {config.cache.folder}; "
            f"run `simnfnd make {shell_line(overrides)}` first"
        )
    classes = config.scenes.own_classes()
    renderer = renderer_of(config).settings
    size = write_pack(out, held, views.view, config.sonar.mount, renderer, classes)
    print(f"pack: {out}: {len(held)} of {len(refs)} frames, {size / len(held) / 1e3:.0f} kB each")
