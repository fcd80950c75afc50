"""From words to a benchmark on disk: all sets, the manifest, the noisy pictures as first entry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...factory import __version__
from ...factory.errors import FactoryError
from ...factory.files import refuse_files, whole_folder
from ...factory.loops import compile_all
from ...factory.progress import stage
from . import page, recorded, sets
from .entering import enter_method
from .folder import (
    NOISY,
    PRACTICE,
    REFERENCES,
    SCHEMA,
    VERSION,
    Benchmark,
    Manifest,
    SetEntry,
)
from .results import read_all
from .tuning import filter_of

NOISY_NAME = "noisy"


def make_benchmark(
    out: Path, sizes: Sequence[int], pairs: int, seed: int, flsea: Path | None, real: Sequence[str]
) -> list[str]:
    """Make a benchmark in a new folder; returns lines to show.

    Raises FactoryError when the folder holds files, or a source cannot be used; nothing is left
    then.
    """
    refuse_files(out)
    names = [recorded.name_of(one) for one in real]
    for name in names:
        if names.count(name) > 1:
            raise FactoryError(f"--real: two of the same name, {name}; rename one")
    compile_all()
    made: dict[str, SetEntry] = {}
    practice: dict[str, SetEntry] = {}
    renders = sets.Renders()
    with whole_folder(out) as root:
        for recipe in sets.recipes(sizes, pairs, seed, flsea):
            stage(f"making {recipe.name}")
            noisy, references = (root / part / recipe.name for part in (NOISY, REFERENCES))
            made[recipe.name] = sets.make(recipe, pairs, noisy, references, renders)
        for recipe in sets.practice_recipes(sizes, pairs, seed):
            stage(f"making practice pairs of {recipe.name}")
            folder = root / PRACTICE / recipe.name
            practice[recipe.name] = sets.make(recipe, pairs, folder / NOISY, folder, renders)
        for given, name in zip(real, names, strict=True):
            stage(f"looking for scenes that stand still in {given}")
            made[name], practice[name] = recorded.make(given, root)
        version = f"simnfnd {__version__}"
        Manifest(SCHEMA, VERSION, version, seed, made, practice).write(root)
    benchmark = Benchmark(out)
    noisy_pictures = filter_of(benchmark, "identity", tuned=False)
    enter_method(benchmark, NOISY_NAME, "the pictures as they are", noisy_pictures)
    page.write(benchmark, read_all(benchmark)[0])
    return [
        *(_line(name, one) for name, one in made.items()),
        f"benchmark: {out} (methods get {out / NOISY}/)",
    ]


def _line(name: str, one: SetEntry) -> str:
    groups = len({picture.group for picture in one.pictures})
    text = f"{name}: {len(one.pictures)} pictures of {groups} scenes, sha256 {one.digest[:16]}"
    if name in sets.PUBLISHED:
        same = sets.PUBLISHED[name] == one.digest
        text += ", as published" if same else ", not the published pictures"
    return text
