"""`simnfnd evaluate real IN`: what methods make of real pictures, without a truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from simnfnd.evaluation.app import hydra_verb
from simnfnd.evaluation.overrides import named
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.extras import Need, require
from simnfnd.factory.settings import build

if TYPE_CHECKING:
    from simnfnd.evaluation.real.downstream import Segmented
    from simnfnd.evaluation.real.measure import RealRow
    from simnfnd.evaluation.real.pictures import File
    from simnfnd.evaluation.real.settings import RealSettings


def real(words: Sequence[str]) -> int:
    """`simnfnd evaluate real IN [KEY=VALUE ...]`."""
    return hydra_verb(run, "real", named(words, "real"))


def run(config: DictConfig) -> None:
    """Measure, print the table and write the report."""
    settings = settings_of(config)
    for key, given in (("models=", settings.models), ("downstream=true", settings.downstream)):
        if given:
            require(Need(key, module) for module in ("torch", "safetensors"))
    import numpy as np

    from simnfnd.evaluation.methods.method import baselines_of, methods_of
    from simnfnd.evaluation.methods.networks import networks_at
    from simnfnd.evaluation.methods.tuning import load_tuned
    from simnfnd.evaluation.real import report
    from simnfnd.evaluation.real.measure import check_masks, measure
    from simnfnd.evaluation.real.pictures import open_folder
    from simnfnd.factory.files import check_writable
    from simnfnd.factory.workers.tasks import TaskPool

    if settings.tuned is not None and not Path(settings.tuned).is_file():
        raise FactoryError(f"tuned={settings.tuned}: no such file; `evaluation tune` writes one")
    tuned = {} if settings.tuned is None else load_tuned(Path(settings.tuned))
    methods = [
        *methods_of(baselines_of(settings.baselines), tuned),
        *networks_at(settings.models, {}),
    ]
    files, notes = open_folder(settings.real, settings.limit)
    if settings.downstream:
        check_masks(files)
    out = settings.folder
    check_writable(out, "out")
    with TaskPool(settings.workers) as pool:
        rows = measure(files, methods, pool, settings.device, settings.image_timeout_s)
    facts: dict[str, Any] = {
        "schema": "simnfnd-real/1",
        "name": Path(settings.real).expanduser().resolve().name,
        "files": [file.name for file in files],
        "notes": list(notes),
    }
    count = min(settings.examples, len(files))
    examples = np.unique(np.linspace(0, len(files) - 1, count).round().astype(int)).tolist()
    # What has been measured is there before the training begins.
    report.write(out, facts, rows, {}, examples)
    if settings.downstream:
        facts["notes"].append(
            f"mIoU: {settings.epochs} epochs, {settings.test_share:.0%} of the pictures tested"
        )
        for segments in _downstream(settings, rows, files):
            report.write(out, facts, rows, segments, examples)
    print((out / "real.md").read_text(encoding="utf-8").split("\n\n")[2])
    print(f"report: {out / 'real.html'}")


def _downstream(
    settings: RealSettings, rows: Sequence[RealRow], files: Sequence[File]
) -> Iterator[dict[str, Segmented]]:
    """Label -> what its network makes of the test pictures, after each row that was trained."""
    from tqdm import tqdm

    from simnfnd.evaluation.real.downstream import segmented

    labels = [file.classes() for file in files]
    alive = [row for row in rows if row.lost is None]
    found: dict[str, Segmented] = {}
    with tqdm(total=len(alive) * settings.epochs, unit="epoch", desc="segmentation") as bar:
        for row in alive:
            found[row.method.label] = segmented(
                row.images,
                labels,
                epochs=settings.epochs,
                test_share=settings.test_share,
                seed=settings.seed,
                progress=bar.update,
            )
            yield found


def settings_of(config: DictConfig) -> RealSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from simnfnd.evaluation.real.settings import RealSettings

    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    if not values["real"]:
        raise FactoryError("real: give a folder of pictures: simnfnd evaluate real IN")
    settings: RealSettings = build(RealSettings, values)
    return settings
