"""`simnfnd benchmark make`, `enter` and `table`: their words."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...factory.cli import Parser
from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError

if TYPE_CHECKING:
    from .folder import Benchmark
    from .methods import Entrant

_FOLDER = Path("outputs", "benchmark")


def main(words: Sequence[str]) -> int:
    """`simnfnd benchmark` alone: says which verbs there are."""
    parser = Parser(prog="simnfnd benchmark")
    parser.add_argument("verb", choices=("make", "enter", "table"))
    parser.parse_args(list(words[:1]))
    raise AssertionError


def make(words: Sequence[str]) -> int:
    """Make the sets, and enter the noisy pictures themselves."""
    given = _make_parser().parse_args(list(words))
    from .making import make_benchmark
    from .sets import MOST_PAIRS

    sizes = _sizes(given.sizes)
    if not 1 <= given.pairs <= MOST_PAIRS:
        raise FactoryError(f"--pairs {given.pairs}: must be 1 to {MOST_PAIRS}")
    if given.seed < 0:
        raise FactoryError(f"--seed {given.seed}: must be 0 or more")
    if given.flsea is not None and not given.flsea.expanduser().is_dir():
        raise FactoryError(f"--flsea {given.flsea}: no such folder")
    flsea = None if given.flsea is None else given.flsea.expanduser().resolve()
    notes = make_benchmark(given.out, sizes, given.pairs, given.seed, flsea, given.real)
    print("\n".join(notes))
    return 0


def enter(words: Sequence[str]) -> int:
    """Measure a method and write its result; 2 when its pictures do not fit."""
    given = _enter_parser().parse_args(list(words))
    from .entering import check_name, enter_method
    from .folder import Benchmark

    if given.tuned and given.baseline is None:
        raise FactoryError("--tuned: is for --baseline")
    if not given.timeout_s > 0:
        raise FactoryError(f"--timeout-s {given.timeout_s:g}: must be more than 0")
    benchmark = Benchmark(given.benchmark)
    check_name(benchmark, given.name, given.about, replace=given.replace)
    entrant = _entrant(given, benchmark)
    problems = entrant.problems(benchmark)
    if problems:
        for line in problems[:20]:
            print(line, file=sys.stderr)
        more = f" (the first 20 of {len(problems)} are shown)" if len(problems) > 20 else ""
        raise FactoryError(f"{given.name}: {len(problems)} pictures do not fit{more}")
    path = enter_method(benchmark, given.name, given.about, entrant, keep=given.keep)
    print(f"result: {path}")
    return _show(benchmark)


def table(words: Sequence[str]) -> int:
    """Show the table and write its page; 1 when result files are refused."""
    parser = Parser(prog="simnfnd benchmark table")
    _add_benchmark(parser)
    given = parser.parse_args(list(words))
    from .folder import Benchmark

    return _show(Benchmark(given.benchmark))


def _show(benchmark: Benchmark) -> int:
    from . import page, results

    found, refused = results.read_all(benchmark)
    for line in refused:
        print(f"refused: {line}", file=sys.stderr)
    if not found:
        raise FactoryError(f"{benchmark.results}: no results; `simnfnd benchmark enter` adds one")
    print(page.write(benchmark, found), end="")
    print(f"\npage: {benchmark.root / page.PAGE}")
    return 1 if refused else 0


def _entrant(given: Any, benchmark: Benchmark) -> Entrant:
    if given.weights is not None:
        require(Need("--weights", module) for module in ("torch", "safetensors"))
    if given.onnx is not None:
        require([Need("--onnx", "onnxruntime")])
    from . import methods, programs, tuning

    if given.denoised is not None:
        return methods.Folder(given.denoised)
    if given.function is not None:
        return methods.Function(given.function)
    if given.onnx is not None:
        return programs.Onnx(given.onnx)
    if given.command is not None:
        return programs.Command(given.command, given.timeout_s)
    if given.weights is not None:
        return methods.weights_of(given.weights, benchmark.sets, given.device)
    return tuning.filter_of(benchmark, given.baseline, tuned=given.tuned)


def _make_parser() -> argparse.ArgumentParser:
    parser = Parser(prog="simnfnd benchmark make")
    parser.add_argument("--out", type=Path, default=_FOLDER, help=f"new folder ({_FOLDER})")
    parser.add_argument(
        "--pairs", type=int, default=16, help="pictures of each simulated set (16); two a place"
    )
    parser.add_argument("--sizes", default="256,512", help="sides in pixels (256,512)")
    parser.add_argument("--seed", type=int, default=1, help="of the noise (1)")
    parser.add_argument("--flsea", type=Path, metavar="FOLDER", help="also sets of FLSea VI")
    parser.add_argument(
        "--real",
        nargs="+",
        default=[],
        metavar="IN",
        help="also sets of these recordings or folders: frames of scenes that stand still",
    )
    return parser


def _enter_parser() -> argparse.ArgumentParser:
    parser = Parser(prog="simnfnd benchmark enter")
    parser.add_argument("name", metavar="NAME", help="of the method in the table")
    _add_benchmark(parser)
    door = parser.add_mutually_exclusive_group(required=True)
    door.add_argument(
        "--denoised", type=Path, metavar="FOLDER", help="denoised pictures, FOLDER/SET/NAME.png"
    )
    door.add_argument(
        "--function",
        metavar="MODULE:FUNCTION",
        help="Python function of a picture, (H, W) float32 in 0..1; with a parameter `geometry` it "
        "gets where range and bearing are",
    )
    door.add_argument("--onnx", type=Path, metavar="FILE", help="ONNX file, see docs/benchmark.md")
    door.add_argument(
        "--command",
        metavar="'PROG {in} {out}'",
        help="program that reads a PNG and writes one; with {in_folder} and {out_folder} a set at "
        "a time; no shell",
    )
    door.add_argument("--weights", help="weights file, folder of a training, or a name that ships")
    door.add_argument("--baseline", metavar="FILTER", help="a filter of `simnfnd evaluate`")
    parser.add_argument(
        "--tuned", action="store_true", help="of --baseline: its parameters, on the practice pairs"
    )
    parser.add_argument("--about", default="", help="one line on the method, for the page")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the denoised pictures")
    parser.add_argument("--replace", action="store_true", help="replace the result of that name")
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto")
    parser.add_argument("--timeout-s", type=float, default=120.0, help="of --command, a picture")
    return parser


def _add_benchmark(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--benchmark", type=Path, default=_FOLDER, help=f"folder of `make` ({_FOLDER})"
    )


def _sizes(text: str) -> tuple[int, ...]:
    try:
        sizes = tuple(int(one) for one in text.split(","))
    except ValueError:
        sizes = ()
    if not sizes or not all(64 <= one <= 2048 for one in sizes) or len(set(sizes)) < len(sizes):
        raise FactoryError(f"--sizes {text}: expected different sides of 64 to 2048, as 256,512")
    return sizes
