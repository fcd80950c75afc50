"""`simnfnd inspect DIR`: what is in a dataset; `simnfnd validate DIR`: is it whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from ..cli import Parser
from ..dataset.folder import dataset_settings
from ..dataset.quality import DatasetSummary, summarize
from ..dataset.schema import CAMERA_LAYERS, SCHEMA
from ..dataset.validate import validate
from ..storage.copies import local_folder

_BAR = 40
_BINS = 10


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
    depth = "every picture was read" if given.deep else "pictures were not read (--deep reads them)"
    if report.errors:
        print(f"invalid: {given.dir}: {len(report.errors)} error(s) in {what}")
        return 1
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
    yield from _table(("split", "location", "scene", "pairs"), _scenes(found))
    yield ""
    yield from _table(("column", "lowest", "mean", "highest", "units", "samples"), _columns(found))
    yield ""
    yield f"noisy against clean, whole picture, {len(found.psnr_db)} of {len(found.splits)} pairs"
    yield from _histogram("PSNR, dB", found.psnr_db)
    yield from _histogram("SSIM", found.ssim)


def _scenes(found: DatasetSummary) -> list[tuple[str, ...]]:
    counts: dict[tuple[str, ...], int] = {}
    for split, row in zip(found.splits, found.table, strict=True):
        key = (str(split), row["location"].decode() or "-", row["scene"].decode())
        counts[key] = counts.get(key, 0) + 1
    return [(*key, str(count)) for key, count in counts.items()]


def _columns(found: DatasetSummary) -> list[tuple[str, ...]]:
    """One line a column: what was drawn lies between lowest and highest."""
    lines: list[tuple[str, ...]] = []
    for column in found.pairs.form.columns:
        if column.name in ("location", "scene", "frame", "seed_key", "boxes"):
            continue
        if np.dtype(column.dtype).kind == "S":
            texts = sorted({text.decode() for text in found.table[column.name]} - {""})
            told = ", ".join(texts[:4]) + (", ..." if len(texts) > 4 else "")
            count = int(np.count_nonzero(found.table[column.name] != b""))
            lines.append((column.name, told or "not drawn", "", "", "", str(count)))
            continue
        values = found.numbers(column.name)
        figures = (
            tuple(f"{v:.6g}" for v in (values.min(), values.mean(), values.max()))
            if values.size
            else ("not drawn", "", "")
        )
        units = "" if column.units == "1" else column.units
        lines.append((column.name, *figures, units, str(values.size)))
    return lines


def _histogram(name: str, values: npt.NDArray[np.float64]) -> Iterator[str]:
    values = values[np.isfinite(values)]
    if not values.size:
        yield f"{name}: pictures are too small for it"
        return
    yield (
        f"{name}: mean {values.mean():.3f}, std {values.std():.3f}, "
        f"{values.min():.3f} to {values.max():.3f}"
    )
    counts, edges = np.histogram(values, bins=_BINS if np.ptp(values) > 0 else 1)
    for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
        bar = "#" * round(_BAR * count / counts.max())
        yield f"  {low:8.3f} to {high:8.3f} |{bar:<{_BAR}} {count}"


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    lines = [head, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    for line in lines:
        yield "  ".join(
            cell.ljust(width) for cell, width in zip(line, widths, strict=True)
        ).rstrip()
