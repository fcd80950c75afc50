"""`simnfnd evaluate downstream IN`: what denoising is worth to segmentation and detection."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from ...factory.errors import FactoryError
from ...factory.settings import build
from ..app import hydra_verb
from ..overrides import named

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ..methods.method import Method
    from .pictures import Labelled
    from .settings import DownstreamSettings
    from .trainings import Done, Training

    Found = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32] | None]


def downstream(words: Sequence[str]) -> int:
    """`simnfnd evaluate downstream IN [KEY=VALUE ...]`."""
    return hydra_verb(run, "downstream", named(words, "real"))


def run(config: DictConfig) -> None:
    """Split, train, test, and write the tables."""
    settings = settings_of(config)
    import numpy as np

    from ...models.recordings.fan.pings import close_last
    from ..methods.method import NOISY, Method, baselines_of
    from ..methods.networks import networks_at
    from . import report, trainings
    from .components import components, similarity
    from .pictures import LEAST_CLASSES, read_real, read_simulated

    filters = [Method(b.name, "", dict(b.default)) for b in baselines_of(settings.baselines)]
    every = [NOISY, *filters, *networks_at(settings.models, {})]
    methods = {one.label: one for one in every}
    real = read_real(settings.real)
    shape = (real.images[0].shape[0], real.images[0].shape[1])
    simulated = None if settings.sim is None else read_simulated(settings.sim, shape)
    component = components(similarity(real.images) > settings.alike)
    print(report.about_components(component, settings.alike))
    split = component if settings.split == "components" else np.arange(len(component))
    plan = trainings.planned(
        list(methods),
        settings.labels,
        range(settings.seed, settings.seed + settings.seeds),
        split,
        settings.folds,
        0 if simulated is None else len(simulated.images),
    )
    classes = max(LEAST_CLASSES, 1 + int(max(mask.max() for mask in real.masks)))
    done = trainings.Done(settings.folder)
    try:
        keys = _trained(settings, plan, methods, (real, simulated), classes, done)
        rows = dict(trainings.by_seed(plan, lambda one: done.get(keys[one])))
    finally:
        done.close()
        close_last()
    print(report.write(settings, (real, simulated), component, rows, plan))
    print(f"tables: {settings.folder / report.TABLE_NAME}")


def _trained(
    settings: DownstreamSettings,
    plan: Sequence[Training],
    methods: dict[str, Method],
    pictures: tuple[Labelled, Labelled | None],
    classes: int,
    done: Done,
) -> dict[Training, str]:
    """Do what is not done; the key of each training."""
    from ...factory.progress import progress_bar
    from ..measurement.fingerprint import (
        network_digest,
        program_digest,
        sources_digest,
    )
    from . import trainings
    from .pictures import denoised_by, inputs_of, targets_of

    real, simulated = pictures
    own = [f"simnfnd.evaluation.downstream.{one}" for one in _DECIDING]
    decides = [
        settings.shrink,
        settings.steps,
        settings.batch,
        classes,
        real.digest,
        program_digest(),
        network_digest(settings.device),
        sources_digest(*own),
    ]
    keys = {}
    for one in plan:
        source = "" if one.percent is not None or simulated is None else simulated.digest
        keys[one] = trainings.key_of(one, methods[one.method].key, source, *decides)
    targets = (
        targets_of(real.masks, settings.shrink, classes),
        None if simulated is None else targets_of(simulated.masks, settings.shrink, classes),
    )

    @cache
    def inputs(label: str) -> Found:
        made = [
            None
            if one is None
            else inputs_of(denoised_by(methods[label], one, settings.device), settings.shrink)
            for one in pictures
        ]
        assert made[0] is not None
        return made[0], made[1]

    how: dict[str, Any] = {
        "classes": classes,
        "steps": settings.steps,
        "batch": settings.batch,
        "device": settings.device,
    }
    left = [one for one in plan if keys[one] not in done]
    with progress_bar(
        total=len(plan), initial=len(plan) - len(left), unit="training", desc="training"
    ) as bar:
        for one in left:
            done.add(keys[one], trainings.run(one, inputs, targets, how))
            bar.update()
    return keys


# What a training's counts depend on, beside methods, pictures and settings.
_DECIDING = ("boxes", "counts", "network", "pictures")


def settings_of(config: DictConfig) -> DownstreamSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from .settings import DownstreamSettings

    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    if not values["real"]:
        raise FactoryError(
            "real: give pictures with masks: simnfnd evaluate downstream IN (Images/, Masks/)"
        )
    settings: DownstreamSettings = build(DownstreamSettings, values)
    return settings
