"""Denoise images, folders, HDF5 shards, videos and recordings of sonars with trained weights."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from simnfnd.factory.cli import Parser
from simnfnd.factory.dataset.read.reader import open_shard
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.files import check_writable
from simnfnd.factory.recordings import open_recording
from simnfnd.models.denoise.denoiser import OVERLAP, TILE, load_denoiser
from simnfnd.models.denoise.files import (
    denoise_file,
    denoise_pings,
    denoise_shard,
    denoise_video,
)
from simnfnd.models.denoise.geometries import FIND, Geometries
from simnfnd.models.denoise.inputs import Item, find_items


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`; 1 when some files were skipped."""
    parser = Parser(prog="simnfnd denoise")
    parser.add_argument(
        "inputs", nargs="+", metavar="IN", help="image, folder, shard, video, .aris, .ddf, .raw"
    )
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
        default=FIND,
        help="of images and videos: `find` it in the picture (default), `polar`, `none`, or a CSV "
        "table of fans as `simnfnd geometry` prints; shards and recordings know theirs",
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
    geometries = Geometries(chosen.geometry)
    check_writable(out, "--out")
    denoise = load_denoiser(
        chosen.weights,
        chosen.device,
        tile=chosen.tile,
        overlap=chosen.overlap,
        always=chosen.always,
    )
    failures: list[str] = []
    warnings: list[str] = []
    with tqdm(total=sum(map(_pictures, items)), unit="image", desc="denoising") as bar:
        for item in items:
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
                elif item.kind == "pings":
                    warning = denoise_pings(
                        item, out, denoise, compare=chosen.compare, tick=bar.update
                    )
                    warnings += [warning] if warning else []
                else:
                    work = denoise_video if item.kind == "video" else denoise_file
                    work(item, out, denoise, geometries.of, compare=chosen.compare, tick=bar.update)
            except FrameError as error:
                failures.append(str(error))
                bar.set_postfix(failed=len(failures))
    if failures and len(failures) == len(items):
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise FactoryError(failures[0] + more)
    for line in failures:
        print(f"skipped: {line}", file=sys.stderr)
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr)
    for line in geometries.summary():
        print(line)
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
    try:
        if item.kind == "shard":
            with open_shard(item.source) as shard:
                return len(shard["noisy"])
        with open_recording(item.source) as recording:
            return len(recording)
    except FactoryError:
        return 0
