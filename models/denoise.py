"""Denoise images, folders of images and HDF5 shards with trained weights."""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import cv2
import h5py
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from factory.errors import FactoryError, FrameError
from factory.shards.files import check_writable, write_atomically
from factory.shards.manifest import MANIFEST_NAME
from factory.shards.reader import open_shard, shard_paths, value_range

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
SHARD_SUFFIXES = (".h5", ".hdf5")
SCHEMA = "simnfnd-denoised/1"

Gray = npt.NDArray[np.float32]
Denoise = Callable[[Gray], Gray]
"""(H, W) float32 in 0..1 -> the same."""

_FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}
_COMPARED = 4


@dataclass(frozen=True)
class Item:
    """One input file and its name below the output folder."""

    source: Path
    relative: Path

    @property
    def is_shard(self) -> bool:
        """Whether it is an HDF5 file and not an image."""
        return self.source.suffix.lower() in SHARD_SUFFIXES


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line, like every other mistake of the user."""
        raise FactoryError(f"denoise: {message} (see `python -m models denoise --help`)")


def main(arguments: Sequence[str]) -> int:
    """`python -m models denoise IN... --out DIR --weights FILE`; 1 when some files were skipped."""
    parser = _Parser(prog="python -m models denoise", description=__doc__)
    parser.add_argument("inputs", nargs="+", metavar="IN", help="image, folder or HDF5 shard")
    parser.add_argument("--out", required=True, help="folder for the results; names are kept")
    parser.add_argument("--weights", required=True, help="weights.safetensors of a training")
    parser.add_argument("--compare", action="store_true", help="also write pictures side by side")
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto")
    chosen = parser.parse_args(list(arguments))
    out = Path(chosen.out).expanduser()
    items = find_items([Path(name).expanduser() for name in chosen.inputs], out)
    check_writable(out, "--out")
    denoise = load_denoiser(chosen.weights, chosen.device)
    digest = hashlib.sha256(Path(chosen.weights).read_bytes()).hexdigest()
    failures = []
    for item in tqdm(items, unit="file", desc="denoising"):
        try:
            if item.is_shard:
                denoise_shard(item, out, denoise, weights_sha256=digest, compare=chosen.compare)
            else:
                denoise_file(item, out, denoise, compare=chosen.compare)
        except FrameError as error:
            failures.append(str(error))
    if failures and len(failures) == len(items):
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise FactoryError(failures[0] + more)
    for line in failures:
        print(f"skipped: {line}", file=sys.stderr)
    print(f"denoised: {len(items) - len(failures)} file(s) in {out}")
    return 1 if failures else 0


def load_denoiser(weights: str | Path, device: str = "auto") -> Denoise:
    """A function that denoises one gray image with the weights of a training."""
    import torch  # seconds; `--help` and typing errors need not wait for it

    from models.samples import denoise_array
    from models.weights import load_weights

    network = load_weights(weights).network
    has_gpu = torch.cuda.is_available()
    if device == "gpu" and not has_gpu:
        raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
    if has_gpu and device != "cpu":
        network.to("cuda")
    return lambda gray: denoise_array(network, gray)


def find_items(inputs: Sequence[Path], out: Path) -> list[Item]:
    """The files to denoise, in a fixed order.

    A folder stands for all images and shards below it, a dataset's folder for its shards alone.
    Raises FactoryError when there is nothing, two results would have one name, or a result would
    replace its input.
    """
    items: dict[Path, Item] = {}
    for path in inputs:
        for item in _of_input(path, out):
            other = items.setdefault(item.relative, item)
            if other.source.resolve() != item.source.resolve():
                raise FactoryError(
                    f"{other.source} and {item.source} would both become {item.relative}; "
                    "denoise them into different folders"
                )
            if (out / item.relative).resolve() == item.source.resolve():
                raise FactoryError(f"--out {out}: would overwrite the input {item.source}")
    return list(items.values())


def denoise_image(image: npt.NDArray[Any], denoise: Denoise) -> npt.NDArray[Any]:
    """Denoise (H, W) or (H, W, C) uint8, uint16 or float32 (0..1); same shape and dtype out.

    Colour channels are denoised one by one (once, when they are equal); an alpha channel stays.
    Raises ValueError for another dtype or shape, NaN, and floats outside 0..1.
    """
    full = _FULL_SCALE.get(str(image.dtype))
    if full is None:
        raise ValueError(f"pixels are {image.dtype}; expected {', '.join(_FULL_SCALE)}")
    if image.ndim == 3:
        result = image.copy()
        colours = 3 if image.shape[2] in (3, 4) else 1
        for channel in range(colours):
            plane = np.ascontiguousarray(image[..., channel])
            same = channel and np.array_equal(plane, image[..., 0])
            result[..., channel] = result[..., 0] if same else denoise_image(plane, denoise)
        return result
    if image.ndim != 2 or 0 in image.shape:
        raise ValueError(f"image has shape {image.shape}; expected (H, W) or (H, W, C)")
    if image.dtype == np.float32 and not (image.min() >= 0 and image.max() <= 1):
        raise ValueError("float pixels must lie in 0..1")
    denoised = denoise(image.astype(np.float32) / np.float32(full))
    if image.dtype == np.float32:
        return denoised
    return np.asarray(np.rint(denoised.astype(np.float64) * full).astype(image.dtype))


def denoise_file(item: Item, out: Path, denoise: Denoise, *, compare: bool) -> None:
    """Denoise one image file into `out`.  FrameError when it cannot be read."""
    content = np.frombuffer(item.source.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise FrameError(f"{item.source}: not a readable image")
    try:
        denoised = denoise_image(image, denoise)
    except ValueError as error:
        raise FrameError(f"{item.source}: {error}") from error
    _write_image(out / item.relative, denoised)
    if compare:
        _write_compared(out, item, [(image, denoised)])


def denoise_shard(
    item: Item, out: Path, denoise: Denoise, *, weights_sha256: str, compare: bool
) -> None:
    """Denoise /noisy of a shard into /denoised of a file of its name; /meta and /axes go along.

    Raises FrameError when it is not a shard of this program, or damaged.
    """
    try:
        source = open_shard(item.source)
    except FactoryError as error:
        raise FrameError(str(error)) from error
    # Made in memory and written in one go, like the shards themselves.
    with (
        source,
        h5py.File("denoised.h5", "w", driver="core", backing_store=False) as target,
    ):
        noisy, full = source["noisy"], value_range(source)
        target.attrs["schema"] = SCHEMA
        target.attrs["config_hash"] = source.attrs["config_hash"]
        target.attrs["weights_sha256"] = weights_sha256
        for name in ("meta", "axes"):
            if name in source:
                source.copy(name, target)
        denoised = target.create_dataset(
            "denoised",
            shape=noisy.shape,
            dtype=noisy.dtype,
            chunks=(1, *noisy.shape[1:]),
            compression="gzip",
            compression_opts=1,
            fletcher32=True,
            track_times=False,
        )
        shown = []
        for row in range(len(noisy)):
            try:
                image = noisy[row]
                denoised[row] = denoise_image(image, denoise)
            except (OSError, ValueError) as error:
                raise FrameError(f"{item.source}: sample {row} is damaged ({error})") from error
            if row < _COMPARED:
                shown.append(tuple(x / full for x in (image, denoised[row], source["clean"][row])))
        target.flush()
        content = target.id.get_file_image()
    path = out / item.relative
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)
    if compare and shown:
        _write_compared(out, item, shown)


def _of_input(path: Path, out: Path) -> Iterator[Item]:
    suffixes = (*IMAGE_SUFFIXES, *SHARD_SUFFIXES)
    if path.is_file():
        if path.suffix.lower() not in suffixes:
            raise FactoryError(f"{path}: neither an image nor a shard ({', '.join(suffixes)})")
        yield Item(path, Path(path.name))
    elif not path.is_dir():
        raise FactoryError(f"{path}: no such file or folder")
    elif (path / MANIFEST_NAME).is_file():
        for shard in shard_paths(path, "all"):
            yield Item(shard, shard.relative_to(path))
    else:
        found = [
            file
            for file in sorted(path.rglob("*"))
            if file.suffix.lower() in suffixes and file.is_file() and not _is_below(file, out)
        ]
        if not found:
            raise FactoryError(f"{path}: holds no image and no shard ({', '.join(suffixes)})")
        for file in found:
            yield Item(file, file.relative_to(path))


def _is_below(file: Path, folder: Path) -> bool:
    return file.resolve().is_relative_to(folder.resolve())


def _write_image(path: Path, image: npt.NDArray[Any]) -> None:
    # JPEG is lossy at any quality; at 100 the least.
    options = [cv2.IMWRITE_JPEG_QUALITY, 100] if path.suffix.lower() in (".jpg", ".jpeg") else []
    done, content = cv2.imencode(path.suffix, image, options)
    if not done:
        raise FrameError(f"{path}: {image.dtype} pixels do not fit this file format")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.tobytes())


def _write_compared(out: Path, item: Item, rows: Sequence[Sequence[npt.NDArray[Any]]]) -> None:
    """Noisy, denoised (and clean) side by side, one row a sample."""
    lines = []
    for images in rows:
        panels = [_shown(image) for image in images]
        gap = np.full((*panels[0].shape[:1], 4, *panels[0].shape[2:]), 128, np.uint8)
        line = [part for panel in panels for part in (gap, panel)][1:]
        lines.append(np.concatenate(line, axis=1))
    sheet = np.concatenate(lines, axis=0)
    _write_image(out / "compare" / item.relative.with_suffix(".png"), sheet)


def _shown(image: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    full = 1.0 if image.dtype.kind == "f" else _FULL_SCALE[str(image.dtype)]
    return np.asarray(np.rint(np.clip(image / full, 0, 1) * 255), dtype=np.uint8)
