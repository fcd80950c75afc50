"""Denoise images, folders of images, HDF5 shards and the frames of videos with trained weights."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import cv2
from tqdm import tqdm

from simnfnd.factory.dataset.read.reader import open_shard
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.files import check_writable
from simnfnd.models.data.fans import read_fans
from simnfnd.models.denoise.denoiser import OVERLAP, TILE, load_denoiser
from simnfnd.models.denoise.files import denoise_file, denoise_shard, denoise_video
from simnfnd.models.denoise.inputs import Item, find_items


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line, like every other mistake of the user."""
        raise FactoryError(f"denoise: {message} (see `simnfnd denoise --help`)")


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`; 1 when some files were skipped."""
    parser = _Parser(prog="simnfnd denoise", description=__doc__)
    parser.add_argument("inputs", nargs="+", metavar="IN", help="image, folder, shard or video")
    parser.add_argument("--out", required=True, help="folder for the results; names are kept")
    parser.add_argument(
        "--weights", help="weights.safetensors of a training, or the name of weights that ship"
    )
    parser.add_argument(
        "--always",
        action="store_true",
        help="denoise also pictures that the network would give back as they came",
    )
    parser.add_argument("--compare", action="store_true", help="also write pictures side by side")
    parser.add_argument(
        "--geometry",
        help="for images: `polar`, or a CSV table of fans (docs/training.md); shards know theirs",
    )
    parser.add_argument(
        "--tile", type=int, default=TILE, help=f"largest side in one go, pixels ({TILE})"
    )
    parser.add_argument(
        "--overlap", type=int, default=OVERLAP, help=f"pixels that tiles share ({OVERLAP})"
    )
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto")
    chosen = parser.parse_args(list(arguments))
    if not 0 <= chosen.overlap <= chosen.tile // 2:
        raise FactoryError(f"--overlap {chosen.overlap}: must be at most half of --tile")
    out = Path(chosen.out).expanduser()
    items = find_items([Path(name).expanduser() for name in chosen.inputs], out)
    fans = read_fans(chosen.geometry) if chosen.geometry not in (None, "polar") else {}
    check_writable(out, "--out")
    denoise = load_denoiser(
        chosen.weights,
        chosen.device,
        tile=chosen.tile,
        overlap=chosen.overlap,
        always=chosen.always,
    )
    failures = []
    with tqdm(total=sum(map(_pictures, items)), unit="image", desc="denoising") as bar:
        for item in items:
            # Pictures missing in the table are denoised without geometry.
            geometry = fans.get(item.source.name)
            known = functools.partial(denoise, layout=chosen.geometry) if not fans else denoise
            try:
                if item.kind == "shard":
                    denoise_shard(
                        item,
                        out,
                        denoise,
                        weights_sha256=denoise.digest,
                        compare=chosen.compare,
                        tick=bar.update,
                    )
                else:
                    work = denoise_video if item.kind == "video" else denoise_file
                    work(item, out, known, geometry, compare=chosen.compare, tick=bar.update)
            except FrameError as error:
                failures.append(str(error))
                bar.set_postfix(failed=len(failures))
    if failures and len(failures) == len(items):
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise FactoryError(failures[0] + more)
    for line in failures:
        print(f"skipped: {line}", file=sys.stderr)
    if denoise.unchanged:
        print(
            f"given back as they came: {denoise.unchanged} of {denoise.pictures} picture(s), "
            "because the network expected too little of denoising them; --always denoises them, too"
        )
    print(f"denoised: {len(items) - len(failures)} file(s) in {out}")
    return 1 if failures else 0


def _pictures(item: Item) -> int:
    """How many pictures a file holds, for the progress bar; 0 for one that cannot be read."""
    if item.kind == "image":
        return 1
    if item.kind == "video":
        capture = cv2.VideoCapture(str(item.source))
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.release()
        return max(0, count)
    try:
        with open_shard(item.source) as shard:
            return len(shard["noisy"])
    except FactoryError:
        return 0
