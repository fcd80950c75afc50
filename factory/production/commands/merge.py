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

from ...common.command_line import Parser
from ...common.errors import FactoryError
from ...common.files import refuse_files, whole_folder
from ...dataset.card import write_card
from ...dataset.folder import dataset_settings, differences, open_folder
from ...dataset.manifest import MANIFEST_NAME, PARTS, Manifest, damage, load_manifest, save_manifest
from ...dataset.pair_dataset import PairDataset
from ...dataset.preview import preview
from ...dataset.schema import SPLITS, Provenance, config_hash
from ...dataset.settings import DatasetSettings
from ...dataset.writer import write_index

# What may differ: which frames there are, how their noise is seeded, and how they are stored.
_FREE = re.compile(
    r"(seed|scenes|frames|frames_found|split|scheduler)(\.|$)"
    r"|dataset\.(compression|compression_level|max_train|max_test)$"
)


def main(words: list[str]) -> None:
    """Merge what `words` name."""
    parser = Parser(prog="simnfnd merge")
    parser.add_argument("dirs", nargs="+", type=Path, metavar="DIR", help="folders of datasets")
    parser.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="new or empty folder to fill"
    )
    parser.add_argument("--name", help="name of the merged dataset (default: merged)")
    parser.add_argument(
        "--licence", help="licence of the merged dataset (default: theirs, if all agree)"
    )
    arguments = parser.parse_args(words)
    manifest = merge(
        arguments.dirs, arguments.out, name=arguments.name or "merged", licence=arguments.licence
    )
    splits = " and ".join(f"{manifest.samples(split)} {split}" for split in SPLITS)
    print(f"merge: {splits} pairs in {len(manifest.shards)} shards")
    print(f"dataset: {arguments.out}")


def merge(
    directories: Sequence[Path], out: Path, *, name: str = "merged", licence: str | None = None
) -> Manifest:
    """Copy the shards of all `directories` into the new dataset `out`; returns its manifest.

    Raises FactoryError when a dataset is not whole, when two differ in more than their frames and
    seeds, when a sample is in two of them, when a scene trains in one and tests in another, or
    when their licences differ and none is given.
    """
    if len(set(directories)) < 2:
        raise FactoryError("merge: give at least two datasets")
    refuse_files(out)
    manifests = {directory: _whole(directory) for directory in directories}
    sources = {directory: PairDataset(directory, "all") for directory in manifests}
    _check_alike(manifests, sources)
    _check_samples(sources)
    stated = {str(dataset_settings(folder).get("licence") or "") or None for folder in manifests}
    if len(stated) > 1 and not licence:
        licences = ", ".join(sorted(str(text) for text in stated))
        raise FactoryError(f"merge: licences differ ({licences}); say which holds with --licence")
    settings = DatasetSettings(name=name, licence=licence or next(iter(stated)))
    with whole_folder(out) as partial:
        return _fill(partial, manifests, _provenance(list(manifests.values())), settings)


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


def _check_alike(manifests: Mapping[Path, Manifest], sources: Mapping[Path, PairDataset]) -> None:
    first, *others = manifests
    expected = _settings_of(manifests[first], sources[first])
    for directory in others:
        settings = _settings_of(manifests[directory], sources[directory])
        if changes := differences(expected, settings, _FREE):
            raise FactoryError(
                f"merge: {first} and {directory} were made with different settings "
                f"({changes}); merge only what differs in frames and seed"
            )


def _settings_of(manifest: Manifest, source: PairDataset) -> dict[str, Any]:
    """What decides the samples of a dataset."""
    # Layers of the camera are as large as the images of the scenes, which may differ.
    sizes = str(source.form.sizes)
    return {"generator": manifest.generator, "sizes": sizes, **manifest.config}


def _check_samples(sources: Mapping[Path, PairDataset]) -> None:
    """No sample twice, and no scene in train here and in test there."""
    owner: dict[tuple[Any, ...], Path] = {}
    place: dict[tuple[str, str], tuple[str, Path]] = {}
    for directory, source in sources.items():
        for name in source.names():
            scene = name.location, name.scene
            before = owner.setdefault((*scene, name.frame, name.variant), directory)
            if before != directory:
                raise FactoryError(
                    f"merge: sample {'/'.join((*scene, name.frame))} variant {name.variant} is in "
                    f"{before} and in {directory}; make one of them without it "
                    "(scenes, frames.only)"
                )
            split, elsewhere = place.setdefault(scene, (name.split, directory))
            if split != name.split:
                raise FactoryError(
                    f"merge: scene {'/'.join(scene)} is in {split} of {elsewhere} and in "
                    f"{name.split} of {directory}; a denoiser would be tested on what it trained "
                    "on (set split.test alike)"
                )


def _provenance(manifests: Sequence[Manifest]) -> Provenance:
    """What all have in common, and under `merged` what each was made with."""
    configs = [manifest.config for manifest in manifests]
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
        for manifest in manifests
    ]
    config = {**common, "merged": parts}
    return Provenance(config, config_hash(config), manifests[0].generator)


def _fill(
    folder: Path,
    manifests: Mapping[Path, Manifest],
    provenance: Provenance,
    settings: DatasetSettings,
) -> Manifest:
    shown = {"name": settings.name, "licence": settings.licence}
    config = {**provenance.config, "dataset": {**provenance.config.get("dataset", {}), **shown}}
    merged = open_folder(folder, config, provenance)
    for split in SPLITS:
        (folder / split).mkdir()
        parts = [
            (directory, info)
            for directory, manifest in manifests.items()
            for info in manifest.of_split(split)
        ]
        for number, (directory, info) in enumerate(parts):
            target = f"{split}/shard-{number:05d}.h5"
            shutil.copyfile(directory / info.path, folder / target)
            merged = merged.with_shard(replace(info, path=target))
    save_manifest(folder, merged)
    if settings.preview_pairs:
        preview(folder, pairs=settings.preview_pairs, trusted=True)
    write_index(folder, merged)
    write_card(folder, merged, provenance, settings)
    return merged
