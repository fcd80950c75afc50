"""README.md of a dataset: what it is, how it was made, how to read it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ..common.files import write_atomically
from .folder import CARD_NAME, PREVIEW_NAME
from .manifest import FAILURES_NAME, Failure, Manifest
from .meaning import grey_meaning, pixel_meaning
from .pair_dataset import PairDataset
from .schema import SCHEMA, SPLITS, Provenance, plain_values
from .settings import DatasetSettings

# Identifiers that the Hugging Face hub knows; anything else goes there as "other" with a name.
_HUB_LICENCES = (
    "apache-2.0", "mit", "cc0-1.0", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc-by-nc-sa-4.0",
    "cc-by-nd-4.0", "cc-by-nc-nd-4.0", "odbl", "pddl", "odc-by", "cdla-permissive-2.0",
)  # fmt: skip
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
PAPER = (
    'T. Yang, T. Zhang, Y. Yao, "SimNFND: A Forward-Looking Sonar Denoising Model Trained on '
    'Simulated Noise-Free and Noisy Data", Remote Sensing 16(15), 2815, 2024'
)
_TITLE = "Simulated forward-looking sonar images, noisy and clean"
_SECTIONS = ("scenes", "render", "resample", "noise", "sonar", "acoustics", "water")


def write_card(
    directory: Path,
    manifest: Manifest,
    provenance: Provenance,
    settings: DatasetSettings,
    failures: Sequence[Failure] = (),
    skipped: Mapping[str, int] | None = None,
    config: Mapping[str, Any] | None = None,
    facts: Sequence[str] = (),
) -> Path:
    """Write README.md, with front matter for the Hugging Face hub, and return its path.

    skipped: reason -> number of images that were left out before the run.
    config: settings to list, under the key names of this version; None: those of `provenance`.
    facts: more lines on how it was made.
    Needs at least one finished shard.
    """
    pairs = PairDataset(directory, "all", trusted=True)
    licence = stated_licence(settings.licence, provenance.config)
    sections = (
        _front_matter(settings, licence, manifest),
        f"# {settings.name}: simulated forward-looking sonar images, noisy and clean",
        _summary(pairs, manifest),
        _preview_link(directory),
        "## How it was made",
        _METHOD,
        _fact_list(manifest, provenance, failures, skipped or {}, facts),
        _settings_block(provenance.config if config is None else config),
        "## What is in it",
        _scene_table(pairs),
        "## How to read it",
        _reading_example(pairs, directory),
        _repair(manifest),
        "## What the numbers mean",
        _meanings(pairs, provenance.config),
        "## Licence",
        f"Of this dataset: {licence or 'not stated (set `dataset.licence`)'}. "
        f"{source_terms(provenance.config)}",
    )
    path = directory / CARD_NAME
    text = "\n\n".join(section for section in sections if section) + "\n"
    write_atomically(path, text.encode())
    return path


_METHOD = f"""\
Simulated, not measured at sea: RGBD frames were turned into 3-D scenes, insonified by a renderer \
with its light at the sonar, and projected into ideal sonar images; noise was added to the echoes \
before projection, so both images of a pair share one scene. The method: {PAPER}."""


def _front_matter(settings: DatasetSettings, licence: str | None, manifest: Manifest) -> str:
    hub = hub_fields(settings.name, licence, manifest.samples())
    return f"---\n{yaml.safe_dump(hub, sort_keys=False)}---"


def _summary(pairs: PairDataset, manifest: Manifest) -> str:
    rows, columns = pairs.shape
    splits = " and ".join(f"{manifest.samples(split)} {split}" for split in SPLITS)
    size_mb = manifest.total_bytes() / 1e6
    return (
        f"{manifest.samples()} pairs of forward-looking-sonar images ({splits}): each sample is a "
        "noisy image, the clean image of the same scene, and the mask of its acoustic shadows. "
        f"{rows} x {columns} pixels, {pairs.dtype}, {size_mb:.1f} MB."
    )


def _preview_link(directory: Path) -> str:
    if not (directory / PREVIEW_NAME).exists():
        return ""
    return f"![noisy, clean and shadow images of some samples]({PREVIEW_NAME})"


def _fact_list(
    manifest: Manifest,
    provenance: Provenance,
    failures: Sequence[Failure],
    skipped: Mapping[str, int],
    more: Sequence[str],
) -> str:
    """The list of facts: program, parts of a merged dataset, images left out, failed frames."""
    facts = [
        f"made by {provenance.generator}, format {SCHEMA}, config hash `{provenance.config_hash}`",
        *more,
    ]
    for part in manifest.config.get("merged", ()):
        facts.append(
            f"merged from a dataset of {part['samples']} pairs, config hash `{part['config_hash']}`"
        )
    for reason, count in sorted(skipped.items()):
        facts.append(f"images left out: {count}, {reason}")
    if failures:
        facts.append(f"frames that failed: {len(failures)}, reasons in {FAILURES_NAME}")
    return "\n".join(f"- {fact}" for fact in facts)


def _settings_block(config: Mapping[str, Any]) -> str:
    listed = {key: config[key] for key in _SECTIONS if key in config}
    text = yaml.safe_dump(plain_values(listed), sort_keys=False, default_flow_style=None)
    return f"```yaml\n{text.rstrip()}\n```"


def _scene_table(pairs: PairDataset) -> str:
    counts = Counter((sample.split, sample.location, sample.scene) for sample in pairs.names())
    lines = ["| split | location | scene | pairs |", "|---|---|---|---|"]
    for key, count in counts.items():
        # Scenes may be called anything.
        cells = [name.replace("|", "\\|") for name in key]
        lines.append(f"| {' | '.join(cells)} | {count} |")
    return "\n".join(lines)


def _reading_example(pairs: PairDataset, directory: Path) -> str:
    shard = pairs.paths[0].relative_to(directory).as_posix()
    return f"""\
```python
import h5py

with h5py.File("{shard}") as shard:
    noisy, clean, shadow = (shard[name][0] for name in ("noisy", "clean", "shadow"))
    made_from = dict(zip(shard["meta"].dtype.names, shard["meta"][0]))
```

`shadow` is true inside the sonar's sector where no echo arrives. `meta` has, for each sample, \
its frame and every number that was drawn for it; `axes` has range and bearing. One chunk is one \
image. `index.h5` joins the shards of small datasets (`index["train/noisy"][0]`) and links to \
those of large ones (`index["train/shard-00000/noisy"][0]`). `manifest.json` lists the shards with \
their SHA-256, `config.yaml` every setting. `simnfnd validate` checks a copy, `simnfnd export` \
writes other formats."""


def _repair(manifest: Manifest) -> str:
    """How to make one shard again; "" for a dataset that was put together of others."""
    if {"merged", "extends"} & set(manifest.config):
        return ""
    count = sum(len(manifest.of_split(split)) for split in SPLITS)
    return f"""\
## How to make one shard again

`shard.index` counts the shards from 0, those of train first; the copy has the same bytes:

```bash
mkdir -p recipe/experiment
(echo "# @package _global_"; cat config.yaml) > recipe/experiment/this.yaml
simnfnd make --config-dir recipe experiment=this shard.index=0 shard.count={count} dataset.dir=again
```"""


def _meanings(pairs: PairDataset, config: Mapping[str, Any]) -> str:
    grey = grey_meaning(config, str(pairs.dtype))
    # Its formulas use range_min_m, range_max_m and metres_per_pixel, columns of `meta`.
    pixels = pixel_meaning(pairs.layout, pairs.shape[1])
    return (
        f"- **Grey values.** Of `noisy` and `clean`: {grey}\n"
        f"- **Pixels.** {pixels} These names are columns of `meta`."
    )


def stated_licence(licence: str | None, config: Mapping[str, Any]) -> str | None:
    """The user's licence; without one that of the procedural scenes, else None.

    config: the dataset's settings, as its shards record them.
    """
    if licence is None and _has_only_procedural_scenes(config):
        return "apache-2.0"
    return licence


def source_terms(config: Mapping[str, Any]) -> str:
    """One sentence on the terms of what the images were made of.

    config: the dataset's settings, as its shards record them.
    """
    if _has_only_procedural_scenes(config):
        return (
            "Its scenes are procedural, made by SimNFND itself (Apache-2.0): no terms of others "
            "apply."
        )
    return "The terms of the source images hold for what is derived from them."


def _has_only_procedural_scenes(config: Mapping[str, Any]) -> bool:
    """Whether SimNFND made all scenes, without meshes or platform movements of the user's."""
    scenes = config.get("scenes")
    return (
        isinstance(scenes, Mapping)
        and scenes.get("kind") == "seabed"
        and not scenes.get("own_objects")
        and not scenes.get("path")
    )


def hub_fields(
    name: str,
    licence: str | None,
    samples: int,
    tasks: Sequence[str] = ("image-to-image",),
    file_format: str = "hdf5",
) -> dict[str, Any]:
    """Return the front matter of a card, as the Hugging Face hub reads it.

    Without a licence there is no entry `license`, which the hub shows as missing.
    """
    category = next((size for limit, size in _SIZES if samples < limit), "n>1M")
    tags = ["sonar", "forward-looking-sonar", "underwater", "denoising", "synthetic", file_format]
    return _licence_fields(licence) | {
        "pretty_name": f"{_TITLE} ({name})",
        "task_categories": list(tasks),
        "size_categories": [category],
        "tags": tags,
    }


def _licence_fields(licence: str | None) -> dict[str, Any]:
    if licence is None:
        return {}
    # `CC BY 4.0` is the hub's cc-by-4.0.
    name = re.sub(r"[^a-z0-9.]+", "-", licence.lower()).strip("-.")
    if name in _HUB_LICENCES:
        return {"license": name}
    return {"license": "other", "license_name": name or "other"}
