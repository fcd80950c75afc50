"""From a method to its result file: every picture of every set denoised, measured and sealed."""

from __future__ import annotations

from pathlib import Path

from ...factory import __version__
from ...factory.errors import FactoryError
from ...factory.files import check_writable, refuse_files
from ...factory.progress import progress_bar
from ...factory.settings import build
from . import pictures, results
from .folder import VERSION, Benchmark
from .measure import Figures, measure
from .methods import Entrant
from .results import ABOUT_MOST, SCHEMA, Made, Result, SetResult


def check_name(benchmark: Benchmark, name: str, about: str, *, replace: bool) -> None:
    """Raise FactoryError for a name that no file can have, or that is taken."""
    plain = name.replace("-", "a").replace("_", "a").replace(".", "a").replace("+", "a")
    if not plain.isascii() or not plain.isalnum() or not name[0].isalnum() or len(name) > 64:
        raise FactoryError(
            f"{name}: no name of a method; at most 64 letters, digits and - _ . +, a letter or "
            "digit first"
        )
    if len(about) > ABOUT_MOST or "\n" in about:
        raise FactoryError(f"--about: one line of at most {ABOUT_MOST} letters")
    path = results.path_of(benchmark, name)
    if path.exists() and not replace:
        raise FactoryError(f"{path}: is there already; give another name, or --replace")
    check_writable(benchmark.results, "--benchmark")


def enter_method(
    benchmark: Benchmark, name: str, about: str, entrant: Entrant, *, keep: Path | None = None
) -> Path:
    """Denoise and measure all sets, and write the result file; returns its path.

    keep: new folder for the denoised pictures, as SET/NAME.png.
    Raises FactoryError, one line, when the method fails on a picture; nothing is written then but
    pictures that were to be kept.
    """
    if keep is not None:
        refuse_files(keep)
        check_writable(keep, "--keep")
    total = sum(len(one.pictures) for one in benchmark.sets.values())
    found: dict[str, SetResult] = {}
    with progress_bar(total=total, unit="picture", desc=name) as bar:
        for own in benchmark.sets.values():
            figures: list[Figures] = []
            outputs: list[str] = []
            seconds: list[float | None] = []
            for one, given, image, took in entrant.run(own):
                figures.append(measure(own, one, image))
                outputs.append(pictures.digest_of(image))
                seconds.append(took)
                if keep is not None:
                    pictures.write(keep / given.where, image)
                bar.update()
            columns = results.columns_of(figures)
            found[own.name] = SetResult(own.entry.digest, tuple(outputs), columns, tuple(seconds))
    made: Made = build(Made, entrant.facts)
    version = f"simnfnd {__version__}"
    return results.write(benchmark, Result(SCHEMA, VERSION, name, about, version, made, found))
