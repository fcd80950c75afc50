"""Datasets in the formats of other ecosystems, one module a format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from ..dataset.reader import Split
from ..dataset.source import open_source
from ..errors import FactoryError
from ..files import refuse_files, whole_folder

# Modules with `write(source, folder) -> str`, which fills an empty folder and returns one line that
# says what it wrote.
FORMATS = ("webdataset", "huggingface", "png", "coco", "yolo")


def export(dataset: Path | str, to: str, out: Path | str, split: Split = "all") -> str:
    """Write `dataset` in format `to` into the new folder `out`; returns what was written.

    The folder appears when it is complete: an export that fails leaves nothing behind.
    Raises FactoryError when the dataset cannot be read, does not fit the format, `out` holds files,
    or the format's library is not installed.
    """
    if to not in FORMATS:
        raise FactoryError(f"--to {to}: no such format; one of {', '.join(FORMATS)}")
    writer, source = import_module(f".{to}", __package__), open_source(Path(dataset), split)
    folder = Path(out)
    refuse_files(folder)
    with whole_folder(folder) as unfinished:
        said: str = writer.write(source, unfinished)
    return said
