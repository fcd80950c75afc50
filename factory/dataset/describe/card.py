"""README.md of a dataset: what it is, how it was made, how to read it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...files import write_atomically
from ..format.echoes import echo_names
from ..format.layout import optional_layers
from ..format.manifest import Manifest
from ..format.schema import SCHEMA, SPLITS, Provenance
from ..format.settings import DatasetSettings
from ..read.overview import Overview, read_overview
from ..read.reader import reading
from ..write.failures import FAILURES_NAME, Failure
from ..write.folder import CARD_NAME, PREVIEW_NAME

# Identifiers that the Hugging Face hub knows; anything else goes there as "other" with a name.
_HUB_LICENCES = (
    "apache-2.0", "mit", "cc0-1.0", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc-by-nc-sa-4.0",
    "cc-by-nd-4.0", "cc-by-nc-nd-4.0", "odbl", "pddl", "odc-by", "cdla-permissive-2.0",
)  # fmt: skip
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_TAGS = ("sonar", "forward-looking-sonar", "underwater", "denoising", "synthetic", "hdf5")
PAPER = (
    'T. Yang, T. Zhang, Y. Yao, "SimNFND: A Forward-Looking Sonar Denoising Model Trained on '
    'Simulated Noise-Free and Noisy Data", Remote Sensing 16(15), 2815, 2024'
)
_SECTIONS = ("render", "resample", "noise", "sonar")


def write_card(
    directory: Path,
    manifest: Manifest,
    provenance: Provenance,
    settings: DatasetSettings,
    failures: Sequence[Failure] = (),
    skipped: Mapping[str, int] | None = None,
) -> Path:
    """Write README.md, with front matter for the Hugging Face hub, and return its path.

    skipped: reason -> images that were left out before the run.  Needs at least one finished shard.
    """
    overview = read_overview(directory, manifest)
    parts = [
        f"---\n{hub_fields(settings.name, settings.licence, manifest.samples())}\n---\n",
        _opening(directory, overview, manifest, settings),
        _making(provenance, manifest, failures, skipped or {}),
        _contents(overview),
        _pictures(directory / overview.samples[0].path),
        *(
            _section(name, provenance.config[name])
            for name in _SECTIONS
            if name in provenance.config
        ),
        _reading(manifest, overview),
        _limits(),
        _licence(settings),
        _citation(),
    ]
    path = directory / CARD_NAME
    write_atomically(path, "\n".join(parts).encode())
    return path


def hub_fields(name: str, licence: str | None, samples: int) -> str:
    """YAML lines of a card's front matter, for the Hugging Face hub."""
    stated = (licence or "unknown").strip()
    known = stated.lower() if stated.lower() in (*_HUB_LICENCES, "unknown") else None
    lines = [f"license: {known or 'other'}"]
    if not known:
        lines.append(f"license_name: {re.sub(r'[^a-z0-9.-]+', '-', stated.lower()).strip('-')}")
    size = next((name for limit, name in _SIZES if samples < limit), "n>1M")
    lines += [
        f"pretty_name: {name}",
        "task_categories:\n- image-to-image",
        "size_categories:\n- " + size,
        "tags:\n" + "\n".join(f"- {tag}" for tag in _TAGS),
    ]
    return "\n".join(lines)


def _opening(
    directory: Path, overview: Overview, manifest: Manifest, settings: DatasetSettings
) -> str:
    rows, columns = overview.shape
    splits = " and ".join(f"{manifest.samples(split)} {split}" for split in SPLITS)
    picture = (
        "![noisy, clean and shadow images of some samples]"
        f"({PREVIEW_NAME})\n\n" if (directory / PREVIEW_NAME).exists() else ""
    )  # fmt: skip
    return (
        f"# {settings.name}\n\n"
        f"{manifest.samples()} pairs of forward-looking-sonar images ({splits}): each sample is a "
        "noisy image, the clean image of the same scene, and the mask of its acoustic shadows. "
        f"{rows} x {columns} pixels, {overview.dtype}, {manifest.total_bytes() / 1e6:.1f} MB.\n\n"
        f"{picture}"
    )


def _making(
    provenance: Provenance,
    manifest: Manifest,
    failures: Sequence[Failure],
    skipped: Mapping[str, int],
) -> str:
    config = provenance.config
    scenes = config.get("scenes")
    kind = scenes.get("kind") if isinstance(scenes, Mapping) else None
    source = f" RGBD frames came from the `{kind}` reader." if kind else ""
    lines = [
        "## How it was made\n",
        "Simulated, not measured at sea: RGBD frames were turned into 3-D scenes, insonified by a "
        "renderer with its light at the sonar, and projected into ideal sonar images; noise was "
        "added to the echoes before projection, so both images of a pair share one scene."
        f"{source}\n",
        f"- generator: {provenance.generator}, format {SCHEMA}",
        f"- config hash: `{provenance.config_hash}` (BLAKE2b, 8 bytes, of what the shards hold as "
        "`config`; all settings are in config.yaml)",
    ]
    if "seed" in config:
        lines.append(f"- seed: {config['seed']}")
    lines.append(f"- {len(manifest.shards)} shards, checksums in manifest.json and croissant.json")
    lines += [
        f"- {how} a dataset of {part['samples']} pairs, config hash `{part['config_hash']}`"
        for key, how in (("merged", "merged from"), ("extends", "extends"))
        for part in manifest.config.get(key, ())
    ]
    lines += [f"- images left out: {count}, {reason}" for reason, count in sorted(skipped.items())]
    if failures:
        lines.append(f"- frames that failed: {len(failures)}, reasons in {FAILURES_NAME}")
    return "\n".join(lines) + "\n"


def _contents(overview: Overview) -> str:
    rows = [
        (split, location, scene, str(count))
        for (split, location, scene), count in overview.counts().items()
    ]
    return "## What is in it\n\n" + _table(("split", "location", "scene", "pairs"), rows)


def _pictures(shard: Path) -> str:
    """The stacks of a shard, as it describes them itself."""
    rows: list[tuple[str, ...]] = []
    with reading(shard) as file:
        for name in ("noisy", "clean", "shadow", *optional_layers(file), *echo_names(file)):
            units, meaning = (str(file[name].attrs[key]) for key in ("units", "description"))
            kind = str(file[name].dtype)
            rows.append((f"`/{name}`", kind, "" if units == "1" else units, meaning))
    return "## Pictures\n\n" + _table(("name", "type", "unit", "what it is"), rows)


def _section(name: str, values: Any) -> str:
    if not isinstance(values, Mapping):
        return f"## {name.capitalize()}\n\n`{values}`\n"
    return f"## {name.capitalize()}\n\n" + _table(("key", "value"), list(_settings(values)))


def _settings(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and not _distribution(value):
            yield from _settings(value, f"{name}.")
        else:
            yield f"`{name}`", _distribution(value) or _value(value)


def _distribution(value: Any) -> str | None:
    """`{uniform: [a, b]}` and its like in words; None for anything else."""
    if not isinstance(value, Mapping) or len(value) != 1:
        return None
    ((kind, numbers),) = value.items()
    if not isinstance(numbers, list | tuple):
        return None
    if kind == "uniform" and len(numbers) == 2:
        return f"drawn evenly from {_value(numbers[0])} to {_value(numbers[1])}"
    if kind == "normal" and len(numbers) == 2:
        return f"drawn normally, mean {_value(numbers[0])}, std {_value(numbers[1])}"
    return f"drawn from {_value(numbers)}" if kind == "choice" else None


def _value(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        shown = ", ".join(_value(item) for item in value[:8])
        return f"{shown}, ... ({len(value)} values)" if len(value) > 8 else shown
    return f"{value:g}" if isinstance(value, float) else str(value)


def _reading(manifest: Manifest, overview: Overview) -> str:
    path = overview.samples[0].path
    (row_axis, row_units), _ = overview.axes
    full = "0..255, 255 is full scale" if overview.dtype == "uint8" else "0..1"
    return (
        "## How to read it\n\n"
        "```python\n"
        "import h5py\n\n"
        f'with h5py.File("{path}") as shard:\n'
        '    noisy, clean, shadow = (shard[name][0] for name in ("noisy", "clean", "shadow"))\n'
        f'    {row_axis} = shard["axes/{row_axis}"][:]  # of every row, in units of {row_units!r}\n'
        '    made_from = dict(zip(shard["meta"].dtype.names, shard["meta"][0]))\n'
        "```\n\n"
        f"`noisy` and `clean` are {full}; `shadow` is true inside the sonar's sector where no echo "
        "arrives. `meta` tells, for each sample, the frame it is of and every number that was "
        "drawn for it. One chunk is one image, so samples can be read in any order. index.h5 shows "
        "all shards as one file (`train/noisy`, `test/noisy`, ...); look first that every file of "
        "manifest.json is there, because HDF5 shows zeros for one that is not.\n\n"
        "`simnfnd validate` checks a copy, `simnfnd export` writes WebDataset, "
        "Hugging Face, PNG and other formats.\n"
    )


def _limits() -> str:
    return (
        "## What it is not\n\n"
        "Values are relative echo strengths after the transfer curve, not target strengths. Scene, "
        "noise and sonar are what the tables above say; what they do not name was not simulated.\n"
    )


def _licence(settings: DatasetSettings) -> str:
    stated = settings.licence or "not stated (set `dataset.licence`)"
    return (
        "## Licence\n\n"
        f"Of this dataset: {stated}.\n\n"
        "The terms of the source images hold for what is derived from them. They are yours to "
        "read and to respect before you use or pass on this dataset.\n"
    )


def _citation() -> str:
    return f"## Citation\n\nThe method: {PAPER}.\n"


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    cells = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells) + "\n"
