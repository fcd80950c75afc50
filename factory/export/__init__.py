"""Datasets in the formats of other ecosystems, one module a format."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from ..dataset.read.reader import Split
from ..dataset.read.source import open_source
from ..errors import FactoryError
from ..files import refuse_files, whole_folder

# --to -> module with `write(source, folder) -> str`, which fills an empty folder and returns one
# line that says what it wrote.  Those of `LABELLED` have `write_labelled(pictures, folder)`, too.
FORMATS = {
    "webdataset": "simnfnd.factory.export.webdataset",
    "huggingface": "simnfnd.factory.export.huggingface",
    "png": "simnfnd.factory.export.png",
    "mdd": "simnfnd.factory.export.mdd",
    "coco": "simnfnd.factory.export.coco",
    "yolo": "simnfnd.factory.export.yolo",
}
LABELLED = ("coco", "yolo")


def export(dataset: Path | str, to: str, out: Path | str, split: Split = "all") -> str:
    """Write `dataset` in format `to` into the new folder `out`; returns what was written.

    The folder appears when it is complete: an export that fails leaves nothing behind.
    A folder of the Marine Debris Dataset goes in place of a dataset to formats of objects.
    Raises FactoryError when the dataset cannot be read, does not fit the format, `out` holds files,
    or the format's library is not installed.
    """
    if to not in FORMATS:
        raise FactoryError(f"--to {to}: no such format; one of {', '.join(FORMATS)}")
    fill = _filler(Path(dataset), to, split)
    folder = Path(out)
    refuse_files(folder)
    with whole_folder(folder) as unfinished:
        return fill(unfinished)


def _filler(dataset: Path, to: str, split: Split) -> Callable[[Path], str]:
    writer = import_module(FORMATS[to])
    if to in LABELLED:
        from .objects import is_mdd, labelled_mdd  # of the extra sonar

        if is_mdd(dataset):
            return partial(writer.write_labelled, labelled_mdd(dataset, split))
    return partial(writer.write, open_source(dataset, split))
