"""`simnfnd export DIR --to FORMAT --out DIR`: a dataset for other ecosystems."""

from __future__ import annotations

from pathlib import Path

from ..cli import Parser
from ..cli.extras import Need, require
from ..dataset.format.schema import SPLITS
from ..errors import FactoryError
from ..export import FORMATS, export
from ..export.hub import check_hub, push
from ..storage.copies import local_folder

# Format -> the modules that write it: of the extra `export`, and of `sonar`.
_NEEDS = {
    "webdataset": ("webdataset", "cv2"),
    "huggingface": ("pyarrow", "cv2"),
    "png": ("cv2",),
    "mdd": ("cv2",),
    "coco": ("cv2", "scipy"),
    "yolo": ("cv2", "scipy"),
}


def main(words: list[str]) -> None:
    """Write the export that `words` ask for."""
    parser = Parser(prog="simnfnd export")
    parser.add_argument("dir", help="folder or URL of a dataset (or of MDD, to coco and yolo)")
    parser.add_argument("--to", required=True, choices=FORMATS, help="format")
    parser.add_argument("--out", required=True, type=Path, help="new or empty folder to fill")
    parser.add_argument("--split", choices=(*SPLITS, "all"), default="all", help="default: all")
    parser.add_argument(
        "--push", metavar="REPO", help="of huggingface: then upload it as this dataset of the hub"
    )
    parser.add_argument("--private", action="store_true", help="if --push makes it: for you alone")
    given = parser.parse_args(words)
    if given.push is not None and given.to != "huggingface":
        raise FactoryError(f"--push goes with --to huggingface, not with --to {given.to}")
    needs = [(f"--to {given.to}", module) for module in _NEEDS.get(given.to, ())]
    needs += [("--push", "huggingface_hub")] if given.push is not None else []
    # pyarrow is of `report`, too.
    others = {"pyarrow": "export"}
    require([Need(what, module, extra=others.get(module, "")) for what, module in needs])
    if given.push is not None:
        check_hub(given.push)
    print(f"export: {export(local_folder(given.dir), given.to, given.out, given.split)}")
    print(f"folder: {given.out}")
    if given.push is not None:
        print(f"hub: {push(given.out, given.push, private=given.private)}")
