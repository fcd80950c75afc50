"""Converts datasets to the formats of other ecosystems."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from ...common.errors import FactoryError
from ...common.extras import Need, require
from ...common.files import refuse_files, whole_folder
from ...dataset.pair_dataset import PairDataset
from ...dataset.reader import Split
from .object_selection import ObjectSelection

# Format -> the libraries that it needs.  `write_FORMAT(pairs, folder)` fills an empty folder and
# returns one line that says what it wrote; it is in the module FORMAT, or in the one of `_MODULES`.
# Writers of OBJECT_FORMATS also take an ObjectSelection.
FORMATS = {
    "webdataset": ("webdataset", "cv2"),
    "huggingface": ("pyarrow", "cv2"),
    "png": ("cv2",),
    "coco": ("cv2",),
    "yolo": ("cv2",),
    "mot": ("cv2",),
    "coco_video": ("cv2",),
    "mcap": ("rosbags", "cv2"),
    "ply": ("open3d", "cv2"),
}
OBJECT_FORMATS = ("huggingface", "coco", "yolo", "mot", "coco_video")
IMAGE_FORMATS = ("huggingface", "coco", "yolo")
"""Formats whose objects belong to single images, not to tracks."""
_MODULES = {"mot": "tracks", "coco_video": "tracks"}


def export(
    dataset: Path | str,
    to: str,
    out: Path | str,
    split: Split = "all",
    *,
    class_names: Sequence[str] = (),
    min_side_px: int | None = None,
    min_visibility_db: float | None = None,
    box: str = "echo",
) -> str:
    """Write `dataset` in format `to` into the new folder `out`; returns what was written.

    The folder appears when it is complete: an export that fails leaves nothing behind.
    class_names, min_side_px: of OBJECT_FORMATS, as `ObjectSelection` describes them.
    min_visibility_db, box: likewise, of IMAGE_FORMATS.
    Raises FactoryError when the dataset cannot be read, does not fit the format, `out` holds files,
    or the format's library is not installed.
    """
    if to not in FORMATS:
        raise FactoryError(f"--to {to}: no such format; one of {', '.join(FORMATS)}")
    selection = ObjectSelection(tuple(class_names), min_side_px, min_visibility_db, box)
    if to not in OBJECT_FORMATS and not selection.is_default:
        raise FactoryError(
            f"--to {to}: --classes and --min-size are for {', '.join(OBJECT_FORMATS)} alone"
        )
    if to not in IMAGE_FORMATS and (box != "echo" or min_visibility_db is not None):
        raise FactoryError(
            f"--to {to}: --box and --min-visibility are for {', '.join(IMAGE_FORMATS)} alone"
        )
    require(Need(f"--to {to}", library) for library in FORMATS[to])
    module = _MODULES.get(to, to)
    write = getattr(import_module(f"{__name__}.{module}"), f"write_{to}")
    options = (selection,) if to in OBJECT_FORMATS else ()
    folder = Path(out)
    refuse_files(folder)
    with PairDataset(dataset, split, layers=None) as pairs, whole_folder(folder) as unfinished:
        summary: str = write(pairs, unfinished, *options)
    return summary
