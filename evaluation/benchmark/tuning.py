"""Filters as they enter: by default, or tuned on the practice pairs with one gain and offset."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...factory.errors import FactoryError
from ...factory.progress import stage
from ...factory.sonar.geometry import FanGeometry
from ..filters import chosen
from ..filters.base import Baseline, Gray, Parameters
from ..methods.method import Method
from ..metrics.fidelity import finite_psnr, psnr
from ..metrics.levels import Levels, fit_levels
from ..real.score import psnr_of
from ..real.tuning import line_search
from .folder import Benchmark, PictureSet
from .measure import RANKED
from .methods import Own
from .pictures import in_unit_range

_FRAMES = 8  # practice pictures that a filter is tuned on, evenly spread


@dataclass(frozen=True, eq=False)
class _Frame:
    noisy: Gray
    clean: Gray
    where: np.ndarray
    geometry: FanGeometry | None


def filter_of(benchmark: Benchmark, name: str, *, tuned: bool) -> Own:
    """A filter of `evaluate`'s registry.  Raises FactoryError for one that there is not.

    tuned: its parameters are searched on the practice pairs of each set; where a set has none, or
    the filter no parameters, those by default are taken.
    """
    (baseline,) = chosen([name]) if name != "all" else (None,)
    if baseline is None or baseline.looks:
        raise FactoryError(f"--baseline {name}: name one filter of a single picture")
    methods: dict[str, Method] = {}
    kept: dict[str, Method] = {}
    for own, pictures in benchmark.sets.items():
        practice = benchmark.practice.get(pictures.entry.practice)
        methods[own] = Method(baseline.name, "", dict(baseline.default))
        if tuned and practice is not None and baseline.grid:
            if practice.name not in kept:
                stage(f"tuning {name} on the practice pairs of {practice.name}")
                kept[practice.name] = _tuned(baseline, practice)
            methods[own] = kept[practice.name]
        elif tuned:
            print(f"{own}: no practice pairs, {name} is taken by default", file=sys.stderr)
    facts = {
        "kind": "baseline",
        "source": baseline.name,
        "parameters": {own: dict(method.parameters) for own, method in methods.items()},
        "levels": {
            own: {"gain": method.levels.gain, "offset": method.levels.offset}
            for own, method in methods.items()
            if method.levels is not None
        },
    }
    return Own(methods, facts)


def _tuned(baseline: Baseline, practice: PictureSet) -> Method:
    frames = _frames(practice)
    if RANKED[practice.entry.kind] == "psnr_levels":
        # Gain and offset are of each picture there, so they are no part of the method.
        best = line_search(baseline, lambda point: _after_levels(baseline, point, frames))
        return Method(baseline.name, "tuned", best.parameters)
    best = line_search(baseline, lambda point: _with_levels(baseline, point, frames)[0])
    levels = _with_levels(baseline, best.parameters, frames)[1]
    return Method(baseline.name, "tuned + levels", best.parameters, levels)


def _frames(practice: PictureSet) -> list[_Frame]:
    count = min(_FRAMES, len(practice.pictures))
    places = (number * len(practice.pictures) // count for number in range(count))
    return [
        _Frame(
            in_unit_range(practice.noisy(one)),
            practice.clean(one),
            practice.mask(one),
            practice.geometry(one),
        )
        for one in (practice.pictures[place] for place in places)
    ]


def _after_levels(baseline: Baseline, point: Parameters, frames: Sequence[_Frame]) -> float:
    values = [
        psnr_of(baseline(one.noisy, point, one.geometry), one.clean, one.where) for one in frames
    ]
    return float(np.mean(values))


def _with_levels(
    baseline: Baseline, point: Parameters, frames: Sequence[_Frame]
) -> tuple[float, Levels]:
    """Mean PSNR in dB with the gain and offset that fit all frames best, and these."""
    made = [(baseline(one.noisy, point, one.geometry), one.clean) for one in frames]
    levels = fit_levels(made)
    values = [finite_psnr(psnr(clean, levels(image), data_range=1.0)) for image, clean in made]
    return float(np.mean(values)), levels
