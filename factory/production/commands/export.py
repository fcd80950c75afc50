"""`simnfnd export DIR --to FORMAT --out DIR`: a dataset for other ecosystems."""

from __future__ import annotations

from pathlib import Path

from ...common.command_line import Parser
from ...dataset.schema import SPLITS
from ...dataset.storage import local_folder
from ..export import FORMATS, export
from ..export.object_selection import BOX_CONVENTIONS


def main(words: list[str]) -> None:
    """Write the export that `words` ask for."""
    parser = Parser(prog="simnfnd export")
    parser.add_argument("dir", help="folder or URL of a dataset")
    parser.add_argument("--to", required=True, choices=FORMATS, help="format to write")
    parser.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="new or empty folder to fill"
    )
    parser.add_argument(
        "--split", choices=(*SPLITS, "all"), default="all", help="pairs to export (all)"
    )
    parser.add_argument(
        "--classes",
        type=_split_names,
        default=(),
        metavar="NAME,NAME",
        help="classes of the objects to export, numbered in this order (default: those that occur)",
    )
    parser.add_argument(
        "--min-size",
        type=int,
        metavar="PX",
        help="smallest width and height of an object's box in pixels (default: 4 for mot and "
        "coco_video, 2 for coco, yolo and huggingface)",
    )
    parser.add_argument(
        "--min-visibility",
        type=float,
        metavar="DB",
        help="for coco, yolo and huggingface: least visibility of an object (how far its echoes "
        "stand out), for example 3",
    )
    parser.add_argument(
        "--box",
        choices=tuple(BOX_CONVENTIONS),
        default="echo",
        help="for coco, yolo and huggingface: what a box encloses, the echoes (default), echoes "
        "and shadow, or the whole object",
    )
    arguments = parser.parse_args(words)
    summary = export(
        local_folder(arguments.dir),
        arguments.to,
        arguments.out,
        arguments.split,
        class_names=arguments.classes,
        min_side_px=arguments.min_size,
        min_visibility_db=arguments.min_visibility,
        box=arguments.box,
    )
    print(f"export: {summary}")
    print(f"folder: {arguments.out}")
    if arguments.to == "huggingface":
        print(f"upload: hf upload OWNER/NAME {arguments.out} --repo-type dataset")


def _split_names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())
