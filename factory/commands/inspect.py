"""`simnfnd inspect DIR`: what is in a dataset; `simnfnd validate DIR`: is it whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from ..cli import Parser, markdown
from ..dataset.folder import dataset_settings
from ..dataset.quality import DatasetSummary, summarize
from ..dataset.schema import CAMERA_LAYERS, SCHEMA
from ..dataset.validate import validate
from ..storage.copies import local_folder


def main(words: list[str]) -> None:
    """Print what `words` ask for."""
    parser = Parser(prog="simnfnd inspect")
    parser.add_argument("path", help="folder or URL of a dataset, or its index.h5")
    parser.add_argument("--pairs", type=int, default=200, help="most pairs to measure (200)")
    given = parser.parse_args(words)
    found = summarize(local_folder(given.path), given.pairs)
    print("\n".join(report(found, str(given.path))))


def check(words: list[str]) -> int:
    """Print what is wrong with the dataset; 0 when nothing is, else 1."""
    parser = Parser(prog="simnfnd validate")
    parser.add_argument("dir", help="folder or URL of a dataset")
    parser.add_argument("--deep", action="store_true", help="read every picture, too")
    given = parser.parse_args(words)
    report = validate(local_folder(given.dir, fresh=True), given.deep)
    for finding in report.findings:
        print(finding)
    what = f"{report.samples} samples in {report.shards} shards"
    if report.errors:
        print(f"invalid: {given.dir}: {len(report.errors)} error(s) in {what}")
        return 1
    depth = "every picture was read" if given.deep else "--deep reads every picture, too"
    print(f"valid: {given.dir}: {what}; {depth}")
    return 0


def report(found: DatasetSummary, name: str) -> Iterator[str]:
    """The lines that `inspect` prints."""
    pairs = found.pairs
    counts = ", ".join(f"{count} {split}" for split, count in pairs.splits.items())
    rows, columns = pairs.shape
    scale = "0..255" if pairs.dtype == np.uint8 else "0..1"
    across, down = (f"{axis.name} [{axis.units}]" for axis in pairs.axes)
    licence = dataset_settings(pairs.folder).get("licence") or "not stated"
    yield f"{name}: {SCHEMA}, made by {found.generator}, config hash {pairs.config_hash}"
    yield f"samples      {counts}, in {len(pairs.paths)} file(s)"
    yield f"pictures     {rows} x {columns} {pairs.dtype} ({scale}), {pairs.layout}"
    yield f"axes         rows {across}, columns {down}"
    yield f"layers       {', '.join(name.replace('/', '_') for name in pairs.form.layers)}"
    if camera := [name for name in pairs.form.layers if name in CAMERA_LAYERS]:
        high, wide = pairs.form.sizes[camera[0]][:2]
        yield f"camera       {high} x {wide} pixels ({', '.join(camera)})"
    yield (
        f"size         {found.stored_bytes / 1e6:.2f} MB on disk, {found.image_bytes / 1e6:.2f} MB "
        f"of pictures ({found.image_bytes / max(found.stored_bytes, 1):.1f} : 1)"
    )
    yield f"compression  {found.compression}"
    yield f"licence      {licence}"
    yield ""
    counted = Counter(
        (str(split), row["location"].decode() or "-", row["scene"].decode())
        for split, row in zip(found.splits, found.table, strict=True)
    )
    scenes = [[*scene, str(count)] for scene, count in counted.items()]
    yield markdown(["split", "location", "scene", "pairs"], scenes)
    head = ["column", "lowest", "mean", "highest", "units", "samples"]
    yield markdown(head, list(_columns(found)))
    yield f"noisy against clean, whole picture, {len(found.psnr_db)} of {len(found.splits)} pairs"
    for name, values in (("PSNR, dB", found.psnr_db), ("SSIM", found.ssim)):
        known = values[np.isfinite(values)]
        if known.size:
            limits = f"{known.min():.3f} to {known.max():.3f}"
            yield f"{name}: mean {known.mean():.3f}, std {known.std():.3f}, {limits}"
        else:
            yield f"{name}: pictures are too small for it"


def _columns(found: DatasetSummary) -> Iterator[list[str]]:
    """One line a column: what was drawn lies between lowest and highest."""
    for column in found.pairs.form.columns:
        if column.name in ("location", "scene", "frame", "seed_key", "boxes"):
            continue
        if np.dtype(column.dtype).kind == "S":
            texts = [text.decode() for text in found.table[column.name] if text]
            named = sorted(set(texts))
            figures, count = [", ".join(named[:4]) + ", ..." * (len(named) > 4), "", ""], len(texts)
        else:
            values = found.numbers(column.name)
            limits = (values.min(), values.mean(), values.max()) if values.size else ()
            figures, count = [f"{value:.6g}" for value in limits], values.size
        units = "" if column.units == "1" else column.units
        shown = figures if count else ["not drawn", "", ""]
        yield [column.name, *shown, units, str(count)]
