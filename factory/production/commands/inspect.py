"""`simnfnd inspect DIR`: what is in a dataset; `simnfnd validate DIR`: is it whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...common.command_line import Parser
from ...common.errors import FactoryError
from ...dataset.folder import dataset_settings
from ...dataset.pair_dataset import PairDataset
from ...dataset.preview import load, spread
from ...dataset.quality import psnr_db, ssim
from ...dataset.reader import reading
from ...dataset.schema import CAMERA_LAYERS, SCHEMA
from ...dataset.storage import local_folder
from ...dataset.validate import validate
from ..cli import markdown


def main(words: list[str]) -> None:
    """Print what `words` ask for."""
    parser = Parser(prog="simnfnd inspect")
    parser.add_argument("path", help="folder or URL of a dataset")
    parser.add_argument(
        "--pairs", type=int, default=200, help="measure at most this many pairs (200)"
    )
    arguments = parser.parse_args(words)
    print("\n".join(report(local_folder(arguments.path), str(arguments.path), arguments.pairs)))


def check(words: list[str]) -> int:
    """Print what is wrong with the dataset; 0 when nothing is, else 1."""
    parser = Parser(prog="simnfnd validate")
    parser.add_argument("dir", help="folder or URL of a dataset")
    parser.add_argument("--deep", action="store_true", help="also read every image")
    arguments = parser.parse_args(words)
    report = validate(local_folder(arguments.dir, fresh=True), arguments.deep)
    for finding in report.findings:
        print(finding)
    contents = f"{report.samples} samples in {report.shards} shards"
    if report.errors:
        print(f"invalid: {arguments.dir}: {len(report.errors)} error(s) in {contents}")
        return 1
    depth = "every image was read" if arguments.deep else "--deep reads every image, too"
    print(f"valid: {arguments.dir}: {contents}; {depth}")
    return 0


def report(path: Path, name: str, most: int = 200) -> Iterator[str]:
    """The lines that `inspect` prints; `most` pairs at most are measured, spread evenly.

    Raises FactoryError when there is no dataset, or a file is damaged.
    """
    if most < 1:
        raise FactoryError(f"--pairs must be at least 1, got {most}")
    pairs = PairDataset(path, "all")
    with reading(pairs.paths[0]) as file:
        generator = str(file.attrs["generator"])
    names = list(pairs.names())
    measured = [load(name).images for name in spread(names, most)]
    counts = ", ".join(f"{count} {split}" for split, count in pairs.splits.items())
    rows, columns = pairs.shape
    scale = "0..255" if pairs.dtype == np.uint8 else "0..1"
    row_axis, column_axis = (f"{axis.name} [{axis.units}]" for axis in pairs.axes)
    licence = dataset_settings(pairs.folder).get("licence") or "not stated"
    yield f"{name}: {SCHEMA}, made by {generator}, config hash {pairs.config_hash}"
    yield f"samples      {counts}, in {len(pairs.paths)} file(s)"
    yield f"images       {rows} x {columns} {pairs.dtype} ({scale}), {pairs.layout}"
    yield f"axes         rows {row_axis}, columns {column_axis}"
    yield f"layers       {', '.join(name.replace('/', '_') for name in pairs.form.layers)}"
    if camera := [name for name in pairs.form.layers if name in CAMERA_LAYERS]:
        high, wide = pairs.form.sizes[camera[0]][:2]
        yield f"camera       {high} x {wide} pixels ({', '.join(camera)})"
    yield f"licence      {licence}"
    yield ""
    scenes = Counter((name.split, name.location or "-", name.scene) for name in names)
    table = [[*key, str(count)] for key, count in scenes.items()]
    yield markdown(["split", "location", "scene", "pairs"], table)
    head = ["column", "lowest", "mean", "highest", "units", "samples"]
    yield markdown(head, list(_columns(pairs)))
    yield f"noisy against clean, whole image, {len(measured)} of {len(names)} pairs"
    for figure, function in (("PSNR, dB", psnr_db), ("SSIM", ssim)):
        values = np.array([function(images["clean"], images["noisy"]) for images in measured])
        known = values[np.isfinite(values)]
        if known.size:
            limits = f"{known.min():.3f} to {known.max():.3f}"
            yield f"{figure}: mean {known.mean():.3f}, std {known.std():.3f}, {limits}"
        else:
            yield f"{figure}: images are too small for it"


def _columns(pairs: PairDataset) -> Iterator[list[str]]:
    """One line per column of /meta: what was drawn lies between lowest and highest."""
    table = pairs.meta()
    for column in pairs.form.columns:
        if column.name in ("location", "scene", "frame", "seed_key", "boxes"):
            continue
        values = table[column.name]
        if values.dtype.kind == "S":
            texts = [text.decode() for text in values if text]
            named = sorted(set(texts))
            figures = [", ".join(named[:4]) + ", ..." * (len(named) > 4), "", ""]
            count = len(texts)
        else:
            values = values[np.isfinite(values)].astype(np.float64)
            limits = (values.min(), values.mean(), values.max()) if values.size else ()
            figures = [f"{value:.6g}" for value in limits]
            count = values.size
        units = "" if column.units == "1" else column.units
        shown = figures if count else ["not drawn", "", ""]
        yield [column.name, *shown, units, str(count)]
