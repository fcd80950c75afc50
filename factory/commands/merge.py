"""`simnfnd merge A B ... --out DIR`: several datasets of one kind into one.

The shards are copied as they are, so their checksums stay what they were.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..cli import Parser
from ..dataset.card import write_card
from ..dataset.folder import dataset_settings, differences, open_folder
from ..dataset.manifest import (
    MANIFEST_NAME,
    PARTS,
    Manifest,
    damage,
    load_manifest,
    save_manifest,
)
from ..dataset.pair_dataset import PairDataset
from ..dataset.preview import preview
from ..dataset.schema import SPLITS, Provenance, config_hash
from ..dataset.settings import DatasetSettings
from ..dataset.writer import write_index
from ..errors import FactoryError
from ..files import refuse_files, whole_folder

# What may differ: which frames there are, how their noise is seeded, and how they are stored.
_FREE = re.compile(
    r"(seed|scenes|frames|frames_found|split|scheduler)(\.|$)"
    r"|dataset\.(compression|compression_level|max_train|max_test)$"
)


def main(words: list[str]) -> None:
    """Merge what `words` name."""
    parser = Parser(prog="simnfnd merge")
    parser.add_argument("dirs", nargs="+", type=Path, metavar="DIR", help="folders of datasets")
    parser.add_argument("--out", required=True, type=Path, help="new or empty folder to fill")
    parser.add_argument("--name", help="of the merged dataset (default: merged)")
    parser.add_argument("--licence", help="of the merged dataset (default: theirs, if all agree)")
    given = parser.parse_args(words)
    manifest = merge(given.dirs, given.out, name=given.name or "merged", licence=given.licence)
    splits = " and ".join(f"{manifest.samples(split)} {split}" for split in SPLITS)
    print(f"merge: {splits} pairs in {len(manifest.shards)} shards")
    print(f"dataset: {given.out}")


def merge(
    directories: Sequence[Path], out: Path, *, name: str = "merged", licence: str | None = None
) -> Manifest:
    """Copy the shards of all `directories` into the new dataset `out`; returns its manifest.

    Raises FactoryError when a dataset is not whole, when two differ in more than their frames and
    seeds, when a sample is in two of them, when a scene trains in one and tests in another, or
    when their licences differ and none is given.
    """
    if len(directories) < 2:
        raise FactoryError("merge: give at least two datasets")
    refuse_files(out)
    manifests = {directory: _whole(directory) for directory in directories}
    if len(manifests) < len(directories):
        raise FactoryError("merge: a dataset is named twice")
    sources = {directory: PairDataset(directory, "all") for directory in directories}
    _check_alike(manifests)
    _check_samples(sources)
    settings = DatasetSettings(name=name, licence=licence or _common_licence(directories))
    provenance = _provenance(manifests)
    with whole_folder(out) as partial:
        return _fill(partial, manifests, provenance, settings)


def _whole(directory: Path) -> Manifest:
    """The manifest of a dataset all of whose shards are as it says."""
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no {MANIFEST_NAME}; give the folder of a dataset")
    for info in manifest.shards.values():
        if wrong := damage(directory, info):
            raise FactoryError(
                f"{directory / info.path}: {wrong}; run the command that made the dataset again"
            )
    return manifest


def _check_alike(manifests: Mapping[Path, Manifest]) -> None:
    first, *others = manifests
    for other in others:
        one, two = manifests[first], manifests[other]
        if one.generator != two.generator:
            raise FactoryError(
                f"merge: {first} was made by {one.generator}, {other} by {two.generator}; "
                "make them with one version"
            )
        if changes := differences(one.config, two.config, _FREE):
            raise FactoryError(
                f"merge: {first} and {other} were made with different settings "
                f"({changes}); merge only what differs in frames and seed"
            )


def _check_samples(sources: Mapping[Path, PairDataset]) -> None:
    """No sample twice, and no scene in train here and in test there."""
    owner: dict[tuple[Any, ...], Path] = {}
    place: dict[tuple[str, str], tuple[str, Path]] = {}
    for directory, source in sources.items():
        for one in source.names():
            split, scene = one.split, (one.location, one.scene)
            sample = (*scene, one.frame, one.variant)
            if sample in owner:
                raise FactoryError(
                    f"merge: sample {'/'.join((*scene, one.frame))} variant {one.variant} is in "
                    f"{owner[sample]} and in {directory}; make one of them without it "
                    "(scenes, frames.only)"
                )
            owner[sample] = directory
            known = place.setdefault(scene, (split, directory))
            if known[0] != split:
                raise FactoryError(
                    f"merge: scene {'/'.join(scene)} is in {known[0]} of {known[1]} and in "
                    f"{split} of {directory}; a denoiser would be tested on what it trained on "
                    "(set split.test alike)"
                )


def _common_licence(directories: Sequence[Path]) -> str | None:
    stated = {directory: dataset_settings(directory).get("licence") for directory in directories}
    if len(set(stated.values())) > 1:
        told = ", ".join(f"{directory}: {value or 'none'}" for directory, value in stated.items())
        raise FactoryError(f"merge: licences differ ({told}); say which holds with --licence")
    return next(str(value) if value else None for value in stated.values())


def _provenance(manifests: Mapping[Path, Manifest]) -> Provenance:
    """What all have in common, and under `merged` what each was made with."""
    configs = [manifest.config for manifest in manifests.values()]
    common = {
        key: value
        for key, value in configs[0].items()
        if all(config.get(key) == value for config in configs) and key not in PARTS
    }
    parts = [
        {
            "config_hash": manifest.config_hash,
            "samples": manifest.samples(),
            **{key: value for key, value in manifest.config.items() if key not in common},
        }
        for manifest in manifests.values()
    ]
    config = {**common, "merged": parts}
    generator = next(iter(manifests.values())).generator
    return Provenance(config, config_hash(config), generator)


def _fill(
    folder: Path,
    manifests: Mapping[Path, Manifest],
    provenance: Provenance,
    settings: DatasetSettings,
) -> Manifest:
    shown = {"name": settings.name, "licence": settings.licence}
    told = {**provenance.config, "dataset": {**provenance.config.get("dataset", {}), **shown}}
    merged = open_folder(folder, told, provenance)
    for split in SPLITS:
        number = 0
        (folder / split).mkdir()
        for directory, manifest in manifests.items():
            for path in sorted(manifest.shards):
                info = manifest.shards[path]
                if info.split == split:
                    target = f"{split}/shard-{number:05d}.h5"
                    shutil.copyfile(directory / path, folder / target)
                    merged = merged.with_shard(replace(info, path=target))
                    number += 1
    save_manifest(folder, merged)
    if settings.preview_pairs:
        preview(folder, pairs=settings.preview_pairs, trusted=True)
    write_index(folder, merged)
    write_card(folder, merged, provenance, settings)
    return merged
