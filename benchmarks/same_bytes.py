"""Do two versions of the project make the same bytes?  One file of hashes, made and compared.

    python -m benchmarks.same_bytes --write FILE       in a checkout of the one version
    python -m benchmarks.same_bytes --against FILE     in one of the other: exit 1 if they differ

It makes a demo (Cycles), images of several devices and layouts with all optional layers, the
physical profile, the ARIS fit, a sweep, short trainings, denoised images and a report; of FLSea
frames (--flsea) the paper's points, the complex field, drawn devices and a pack of renders, by one
worker, by 48, and killed in the middle and resumed.  It notes the SHA-256 of every image, mask,
table and attribute of every shard, of weights and of figures.  What is written beside them for
people to read (cards, messages) is not compared.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

SMALL = ("scenes.locations=2", "scenes.frames_per_location=1", "scenes.width=320",
         "scenes.height=200", "scheduler=serial")  # fmt: skip
LAYERS = "dataset.layers=[range,elevation,effects]"

DATASETS: dict[str, tuple[str, ...]] = {
    "demo": ("experiment=demo",),
    "points_polar": ("render=analytic", *SMALL, "sonar=oculus_m750d_hf", LAYERS,
                     "sonar.image.layout=polar", "sonar.transfer.kind=power", "frames.variants=2"),
    "points_mounted": ("render=embree", *SMALL, "sonar.mount.translation_m=[0,0,0.5]",
                       "noise.range_arc.count=2", "dataset.dtype=float32"),
    "physical": ("experiment=physical", "render=analytic", *SMALL, LAYERS, "frames.variants=2"),
    "physical_restored": ("experiment=physical", "render=analytic", *SMALL,
                          "acoustics.target=restored", "sonar=oculus_m1200d_hf"),
    "physical_background": ("experiment=physical", "render=analytic", *SMALL,
                            "noise.background.enabled=true"),
    "aris_mdd": ("experiment=aris_mdd", "render=analytic", *SMALL, "scenes.kinds=null"),
}  # fmt: skip

# Of real frames, in shards of two pairs: points, field, drawn devices.
REAL: dict[str, tuple[str, ...]] = {
    "flsea_points": ("noise=simnfnd", "frames.variants=2"),
    "flsea_field": (
        "acoustics=coherent",
        "noise=physical",
        "water=sea",
        "sonar=oculus_m750d_hf",
        LAYERS,
        "frames.variants=2",
    ),
    "flsea_any_sonar": (
        "devices=any_sonar",
        "noise=any_sonar",
        "acoustics=coherent",
        "frames.variants=2",
    ),
}
FEW = ("render=analytic", "frames.total=4", "scheduler.shard_size=2", "dataset.preview_pairs=0")
ONE = ("scheduler=serial",)
MANY = ("scheduler=local", "scheduler.workers=48")


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    choice = parser.add_mutually_exclusive_group(required=True)
    choice.add_argument("--write", type=Path, metavar="FILE")
    choice.add_argument("--against", type=Path, metavar="FILE")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("outputs/stray-bytes"),
        help="folder for both files where two shards hold the same and are not the same bytes",
    )
    parser.add_argument("--only", nargs="*", help="names of datasets; the rest is left out")
    parser.add_argument("--flsea", type=Path, default=Path("../shared/data/flsea-vi"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="same-bytes-") as folder:
        hashes = everything(Path(folder), options.only)
        if options.flsea.is_dir():
            hashes |= of_real_frames(
                Path(folder), options.flsea.resolve(), options.only, options.keep
            )
    if options.write:
        options.write.write_text(json.dumps(hashes, indent=1, sort_keys=True) + "\n")
        print(f"{len(hashes)} hashes: {options.write}")
        return 0
    expected = json.loads(options.against.read_text())
    if options.only:
        expected = {key: value for key, value in expected.items() if key in hashes}
    different = sorted(key for key in {*expected, *hashes} if expected.get(key) != hashes.get(key))
    for key in different:
        print(f"differs: {key}: {expected.get(key)} became {hashes.get(key)}")
    print(f"{len(hashes)} hashes, {len(different)} differ")
    return 1 if different else 0


def everything(folder: Path, only: list[str] | None) -> dict[str, str]:
    """Name -> hash of all that is compared."""
    hashes: dict[str, str] = {}
    for name, words in DATASETS.items():
        if only is not None and name not in only:
            continue
        dataset = folder / name
        run("simnfnd.factory", *words, f"dataset.dir={dataset}", f"cache.dir={folder / 'cache'}")
        run("simnfnd.factory", "validate", str(dataset), "--deep")
        hashes |= {f"{name}/{key}": value for key, value in dataset_hashes(dataset).items()}
    if only is not None:
        return hashes
    # The points of a sweep name their own folders, by the hash of their configuration.
    run("simnfnd.factory", "-m", "render=analytic", *SMALL, f"cache.dir={folder / 'cache'}",
        "noise.background.density=0.1,0.5", "resample.rate=0.1,0.3", "dataset.name=same-bytes",
        f"hydra.sweep.dir={folder / 'sweep'}")  # fmt: skip
    for point in sorted(Path("outputs").glob("same-bytes-*")):
        hashes |= {f"sweep/{point.name}/{key}": v for key, v in dataset_hashes(point).items()}
        shutil.rmtree(point)
    short = ("train.steps=4", "train.check_every=2", "train.warmup=1", "data.patch=64",
             "data.batch=2", "data.crops=1", "data.workers=0", "device=cpu")  # fmt: skip
    demo = folder / "demo"
    for name, words in {
        "train_pairs": (f"dataset={demo}", "model=nafnet"),
        "train_sonarnet": (f"dataset={demo}", "model=sonarnet"),
        "train_renders": (f"dataset={demo}", "data=renders", "model=nafnet"),
    }.items():
        out = folder / name
        run("simnfnd.models", *words, *short, f"out={out}")
        hashes[name] = weights_hash(out / "weights.safetensors")
    denoised = folder / "denoised"
    run("simnfnd.models", "denoise", str(demo), "--out", str(denoised))
    for path in sorted(denoised.rglob("*.h5")):
        for key, value in shard_hashes(path).items():
            hashes[f"denoised/{path.relative_to(denoised)}/{key}"] = value
    report = folder / "report"
    run("simnfnd.evaluation", f"dataset={demo}", "baselines=[fast]", f"out={report}", "limit=4",
        "bootstrap=100", f"models=[{folder / 'train_pairs'}]")  # fmt: skip
    hashes["report"] = figures_hash(report / "results.csv")
    return hashes


def of_real_frames(folder: Path, root: Path, only: list[str] | None, keep: Path) -> dict[str, str]:
    """The same of FLSea frames.  Raises SystemExit where workers, a kill or a pack change bytes."""
    hashes: dict[str, str] = {}
    scenes = ("scenes=flsea", f"scenes.root={root}")
    for name, words in REAL.items():
        if only is not None and name not in only:
            continue
        words = (*words, *FEW, f"cache.dir={folder / 'real-cache'}")
        dataset = folder / name
        run("simnfnd.factory", *words, *scenes, *ONE, f"dataset.dir={dataset}")
        expected = dataset_hashes(dataset)
        hashes |= {f"{name}/{key}": value for key, value in expected.items()}
        ways = {"many": MANY, "killed": (*ONE, "cache.enabled=false")}
        for way, overrides in ways.items():
            second_dataset = folder / f"{name}_{way}"
            if way == "killed":
                kill_in_the_middle(
                    second_dataset, *words, *scenes, *overrides, f"dataset.dir={second_dataset}"
                )
            run("simnfnd.factory", *words, *scenes, *overrides, f"dataset.dir={second_dataset}")
            same(
                f"{name}, {way}",
                expected,
                dataset_hashes(second_dataset),
                dataset,
                second_dataset,
                keep,
            )
        pack = folder / f"{name}.pack"
        packed = folder / f"{name}_packed"
        run("simnfnd.factory", "cache", "pack", "--out", str(pack), *words, *scenes)
        run("simnfnd.factory", *words, "scenes=pack", f"scenes.root={pack}", *ONE,
            f"dataset.dir={packed}")  # fmt: skip
        hashes |= {f"{name}_packed/{key}": value for key, value in dataset_hashes(packed).items()}
    return hashes


def same(
    label: str,
    expected: dict[str, str],
    actual: dict[str, str],
    first: Path,
    second: Path,
    keep: Path,
) -> None:
    """Raise SystemExit where two datasets of one version differ.

    Shards that hold the same and are not the same bytes are copied to `keep`.
    """
    if expected == actual:
        return
    keys = sorted(k for k in {*expected, *actual} if expected.get(k) != actual.get(k))
    stray = [key for key in keys if key.endswith(".h5") and not _parts_differ(key, keys)]
    for shard in stray:
        for name, folder in (("first", first), ("second", second)):
            copy = keep / name / shard
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / shard, copy)
    copies_note = f"; both files of {', '.join(stray)} are in {keep}" if stray else ""
    raise SystemExit(
        f"{label}: {len(keys)} parts have other bytes: {', '.join(keys[:5])}{copies_note}"
    )


def _parts_differ(shard: str, keys: list[str]) -> bool:
    """Whether a dataset or attribute in the shard is among the keys that differ."""
    return any(key.startswith(f"{shard}/") for key in keys)


def kill_in_the_middle(folder: Path, *words: str) -> None:
    """Kill a run, its workers too, as soon as its first shard is there."""
    print("killed in the middle: python -m simnfnd.factory", *words, flush=True)
    with subprocess.Popen(
        [sys.executable, "-m", "simnfnd.factory", *words], start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        while process.poll() is None and not any(folder.glob("*/shard-*.h5")):
            time.sleep(0.02)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def run(*words: str) -> None:
    """Run one of the programs of the checkout; its output is shown when it fails."""
    print("python -m", *words, flush=True)
    done = subprocess.run(
        [sys.executable, "-m", *words],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}")


def dataset_hashes(folder: Path) -> dict[str, str]:
    """Shard -> hash of each part of it."""
    return {
        f"{path.relative_to(folder)}/{key}": value
        for path in sorted(folder.glob("*/shard-*.h5"))
        for key, value in shard_hashes(path).items()
    } | {
        f"{path.relative_to(folder)}": hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("*/shard-*.h5"))
    }


def shard_hashes(path: Path) -> dict[str, str]:
    """Part of a shard -> hash: its datasets and attributes one by one, so a change has a name."""
    hashes: dict[str, str] = {}
    with h5py.File(path) as file:

        def note(name: str, item: h5py.Dataset | h5py.Group) -> None:
            for key, value in sorted(item.attrs.items()):
                if isinstance(value, str | bytes | np.generic):
                    hashes[f"{name}@{key}"] = hashlib.sha256(repr(value).encode()).hexdigest()
            if isinstance(item, h5py.Dataset):
                hashes[name] = hashlib.sha256(np.ascontiguousarray(item[()]).tobytes()).hexdigest()

        note("", file)
        file.visititems(note)
    return hashes


def weights_hash(path: Path) -> str:
    """Hash of the tensors alone: the words beside them may be written otherwise."""
    data = path.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    return hashlib.sha256(data[start:]).hexdigest()


def figures_hash(path: Path) -> str:
    """Hash of a report's figures of every pair and method, without its times."""
    table = pd.read_csv(path, float_precision="round_trip", low_memory=False)
    digest = hashlib.sha256()
    for name in sorted(map(str, table)):
        if "ms" in name.split("_") or "time" in name or name == "shard":
            continue
        digest.update(name.encode() + b"\0" + "\n".join(map(repr, table[name].tolist())).encode())
    return digest.hexdigest()


if __name__ == "__main__":
    sys.exit(main())
