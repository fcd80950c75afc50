"""`simnfnd evaluate real IN`: what methods make of real pictures and recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from simnfnd.evaluation.app import hydra_verb
from simnfnd.evaluation.overrides import named
from simnfnd.factory.cli.extras import Need, require
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.settings import build

if TYPE_CHECKING:
    from simnfnd.evaluation.real.downstream import Segmented
    from simnfnd.evaluation.real.groups import Judged
    from simnfnd.evaluation.real.measure import RealRow
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
    from simnfnd.evaluation.methods.method import baselines_of, methods_of
    from simnfnd.evaluation.methods.networks import networks_at
    from simnfnd.evaluation.methods.tuning import load_tuned
    from simnfnd.evaluation.real import report
    from simnfnd.evaluation.real.judging import judge
    from simnfnd.evaluation.real.shots import open_input
    from simnfnd.factory.files import check_writable
    from simnfnd.factory.recordings.fans import close_last
    from simnfnd.factory.workers.tasks import TaskPool

    if settings.tuned is not None and not Path(settings.tuned).is_file():
        raise FactoryError(f"tuned={settings.tuned}: no such file; `evaluation tune` writes one")
    tuned = None if settings.tuned is None else load_tuned(Path(settings.tuned))
    baselines = baselines_of(settings.baselines)
    networks = networks_at(settings.models, {})
    stretches, notes = open_input(settings.real, settings.search)
    if settings.downstream:
        for shot in (shot for stretch in stretches for shot in stretch.shots):
            if shot.mask is None:
                raise FactoryError(f"downstream: {shot.path} has no mask of its name in Masks/")
    out = settings.folder
    check_writable(out, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(
            settings,
            stretches,
            baselines,
            methods_of(baselines, tuned or {}) if tuned is not None else [],
            networks,
            pool,
        )
    facts: dict[str, Any] = {
        "schema": "simnfnd-real/2",
        "name": Path(settings.real).expanduser().resolve().name,
        **outcome.facts(),
        "notes": [*notes, *outcome.notes],
    }
    # What has been measured is there before the training begins.
    report.write(out, facts, outcome, {})
    if settings.downstream:
        facts["notes"].append(
            f"mIoU: {settings.epochs} epochs, {settings.test_share:.0%} of the pictures tested"
        )
        for segments in _downstream(settings, outcome.rows, outcome.shown):
            report.write(out, facts, outcome, segments)
    close_last()
    print(report.terminal(out))
    print(f"report: {out / 'real.html'}")


def _downstream(
    settings: RealSettings, rows: Sequence[RealRow], shown: Mapping[int, Judged]
) -> Iterator[dict[str, Segmented]]:
    """Label -> what its network makes of the test pictures, after each row that was trained."""
    from simnfnd.evaluation.real.downstream import segmented
    from simnfnd.factory.progress import progress_bar

    labels = [shown[number].shot.classes() for number in sorted(shown)]
    alive = [row for row in rows if row.lost is None]
    found: dict[str, Segmented] = {}
    with progress_bar(total=len(alive) * settings.epochs, unit="epoch", desc="segmentation") as bar:
        for row in alive:
            found[row.label] = segmented(
                [row.images[number] for number in sorted(shown)],
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
        raise FactoryError("real: give pictures or a recording: simnfnd evaluate real IN")
    settings: RealSettings = build(RealSettings, values)
    return settings
