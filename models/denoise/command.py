"""Denoise images, folders of images, HDF5 shards and the frames of videos with trained weights."""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from simnfnd.factory.cli import Parser
from simnfnd.factory.dataset.read.reader import open_shard
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.files import check_writable
from simnfnd.models.data.geometry import Geometry, polar_picture, read_fans
from simnfnd.models.denoise.files import (
    Gray,
    denoise_file,
    denoise_image,
    denoise_shard,
    denoise_video,
)
from simnfnd.models.denoise.inputs import Item, find_items
from simnfnd.models.denoise.tile import Maps, tiled

__all__ = ["Denoiser", "Item", "denoise_image", "find_items", "load_denoiser", "main"]

TILE, OVERLAP = 1024, 96


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`; 1 when some files were skipped."""
    parser = Parser(prog="simnfnd denoise")
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
            # Of an unknown picture nothing is told, and the network does without.
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
    if denoise.left:
        print(
            f"given back as they came: {denoise.left} of {denoise.seen} picture(s), because the "
            "network expected too little of denoising them; --always denoises them, too"
        )
    print(f"denoised: {len(items) - len(failures)} file(s) in {out}")
    return 1 if failures else 0


class Denoiser:
    """Trained weights as a function of a picture.

    digest: SHA-256 of the weights file.  tile, overlap: see `simnfnd.models.denoise.tile`.
    seen, left: how many pictures it was given, and how many of them it gave back as they came.
    """

    def __init__(
        self, weights: Path, device: str, tile: int, overlap: int, always: bool = False
    ) -> None:
        """always: denoise also what the network would give back as it came.

        Raises FactoryError for a file that holds no weights, and for a GPU that is not there.
        """
        import torch  # seconds; `--help` and typing errors need not wait for it

        from simnfnd.models.weights import load_weights

        self.trained = load_weights(weights)
        self.digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        self.tile, self.overlap = tile, overlap
        self.seen = self.left = 0
        network = self.trained.network
        self._least_gain_db = None if always else network.least_gain_db
        # The verdict is on a whole picture, here: tiles that were left alone among others that were
        # not would show.
        network.leave_none()
        has_gpu = torch.cuda.is_available()
        if device == "gpu" and not has_gpu:
            raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
        if has_gpu and device != "cpu":
            network.to("cuda")

    def __call__(
        self, gray: Gray, geometry: Geometry | None = None, *, layout: str | None = None
    ) -> Gray:
        """(H, W) float32 in 0..1 -> the same, denoised.

        geometry: where range and bearing are, if that is known; or layout `polar`: rows are ranges,
        near range first, and the columns span 30 degrees.
        """
        if geometry is None and layout == "polar":
            geometry = polar_picture(*gray.shape)
        extras = self.trained.network.extras
        maps = {}
        if geometry is not None and extras:
            found = geometry.maps(0, 0, *gray.shape)
            maps = {name: found[name] for name in extras if name in found}
        gains_db: list[float] = []
        areas: list[int] = []

        def work(part: Gray, maps: Maps) -> Gray:
            denoised, gain_db = self._one(part, maps)
            if gain_db is not None:
                gains_db.append(gain_db)
                areas.append(part.size)
            return denoised

        denoised = tiled(work, gray, maps, self.tile, self.overlap)
        self.seen += 1
        least_db = self._least_gain_db
        if least_db is not None and np.average(gains_db, weights=areas) < least_db:
            self.left += 1
            return gray.copy()
        return denoised

    def _one(self, gray: Gray, maps: Maps) -> tuple[Gray, float | None]:
        import torch

        from simnfnd.models.training.samples import denoise_and_tell

        images = {"noisy": gray, **maps}
        batch = {
            name: torch.from_numpy(np.ascontiguousarray(image))[None, None]
            for name, image in images.items()
        }
        return denoise_and_tell(self.trained.network, batch)


def load_denoiser(
    weights: str | Path | None = None,
    device: str = "auto",
    *,
    tile: int = TILE,
    overlap: int = OVERLAP,
    always: bool = False,
) -> Denoiser:
    """A function that denoises one gray image.

    weights: a file that training wrote, the name of weights that ship, or None for the default of
    these.  always: see `Denoiser`.
    Raises FactoryError when there are none, and as `Denoiser` does.
    """
    from simnfnd.models.pretrained import find_weights

    return Denoiser(find_weights(weights), device, tile, overlap, always)


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
