"""Holds classical denoisers: one registry, and for each the grid that tuning searches."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...factory.common import extensions
from ...factory.common.array_types import Array, Floats
from ...factory.common.errors import FactoryError
from ..metrics.measure import Grey
from .bm3d import bm3d
from .classical import (
    bilateral,
    frost,
    gaussian,
    grey_opening,
    identity,
    kuan,
    lee,
    median,
    nlm,
    srad,
    total_variation,
    wavelet,
)
from .rivals.lpmsde import lpmsde
from .rivals.pixel2pixel import pixel2pixel

Number = int | float
Parameters = dict[str, Number]


@dataclass(frozen=True)
class Baseline:
    """One method: a pure function and a grid to tune it on.

    function: (image, **parameters) -> (H, W).
    default: what its authors or its library recommend, scaled to 0..1.
    grid: the values to try of each parameter, ascending; parameters not in it stay at the default.
    source: where the method was published.
    """

    name: str
    function: Callable[..., Floats]
    default: Mapping[str, Number]
    grid: Mapping[str, tuple[Number, ...]]
    source: str

    def __post_init__(self) -> None:
        for parameter, values in self.grid.items():
            if parameter not in self.default:
                raise ValueError(
                    f"method {self.name!r}: its grid has {parameter}, which has no default"
                )
            if not values:
                raise ValueError(f"method {self.name!r}: its grid has no value of {parameter}")

    def points(self) -> list[Parameters]:
        """Every combination of the grid, completed by the defaults."""
        combinations = itertools.product(*self.grid.values())
        return [{**self.default, **dict(zip(self.grid, c, strict=True))} for c in combinations]

    def __call__(self, image: Array, parameters: Mapping[str, Number]) -> Grey:
        """The denoised image, (H, W) float32 clipped to 0..1.

        Raises FactoryError when the method gives another shape or a value that is no number.
        """
        image = np.array(image, np.float32)  # a copy, which the method may change
        return checked(self.name, np.asarray(self.function(image, **parameters)), image)


def checked(name: str, result: Array, image: Grey) -> Grey:
    """What a method made of an image, float32 clipped to 0..1.  Raises FactoryError."""
    if result.shape != image.shape or not np.isfinite(result).all():
        raise FactoryError(f"{name}: gave {result.shape} or NaN for an image of {image.shape}")
    return np.clip(result, 0, 1).astype(np.float32)


_SIZES = (3, 5, 7, 9, 13)
_WIDE = (*_SIZES, 19, 27)
_CVS = (0.1, 0.2, 0.35, 0.52, 0.8, 1.2, 2.0)

_FILTERS = (
    Baseline("identity", identity, {}, {}, "the noisy image"),
    Baseline("median", median, {"size": 3}, {"size": _SIZES}, "Tukey 1971"),
    Baseline("gaussian", gaussian, {"sigma_px": 1.0},
             {"sigma_px": (0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)}, "textbook"),
    Baseline("grey_opening", grey_opening, {"size": 3},
             {"size": (2, 3, 4, 5, 7, 9, 13)}, "Serra 1982"),
    Baseline("bilateral", bilateral, {"sigma_px": 2.0, "sigma_gray": 0.1},
             {"sigma_px": (0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0),
              "sigma_gray": (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 100.0)},
             "Tomasi and Manduchi 1998 (OpenCV)"),
    Baseline("nlm", nlm, {"strength": 0.04},
             {"strength": (0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.45, 0.65)},
             "Buades, Coll and Morel 2005 (OpenCV)"),
    Baseline("bm3d", bm3d, {"sigma": 0.1},
             {"sigma": (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0)},
             "Dabov et al. 2007 (own, from the paper)"),
    Baseline("tv", total_variation, {"weight": 0.1},
             {"weight": (0.01, 0.03, 0.06, 0.1, 0.17, 0.3, 0.5, 0.8)},
             "Rudin, Osher and Fatemi 1992; Chambolle 2004 (scikit-image)"),
    Baseline("wavelet", wavelet, {"strength": 0.15, "levels": 3},
             {"strength": (0.03, 0.07, 0.15, 0.3, 0.6, 1.2), "levels": (1, 2, 3, 4, 6, 8)},
             "Coifman and Donoho 1995, Haar (own)"),
    Baseline("lee", lee, {"size": 7, "noise_cv": 0.52},
             {"size": _WIDE, "noise_cv": _CVS}, "Lee 1980"),
    Baseline("kuan", kuan, {"size": 7, "noise_cv": 0.52},
             {"size": _WIDE, "noise_cv": _CVS}, "Kuan et al. 1985"),
    Baseline("frost", frost, {"size": 5, "damping": 2.0},
             {"size": _SIZES, "damping": (0.3, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)},
             "Frost et al. 1982"),
    Baseline("srad", srad, {"iterations": 100, "initial_cv": 1.0, "step": 0.2, "decay": 1 / 6},
             {"iterations": (1, 10, 30, 100, 250), "initial_cv": (0.1, 0.3, 1.0, 3.0)},
             "Yu and Acton 2002"),
)  # fmt: skip

_RIVALS = (
    Baseline("lpmsde", lpmsde, {"strength": 1.0, "levels": 3},
             {"strength": (0.25, 1.0, 4.0, 16.0, 64.0, 256.0, 1000.0), "levels": (1, 2, 3, 4, 5)},
             "IEEE Access 2023, 3335372, after the abstract"),
    Baseline("pixel2pixel", pixel2pixel, {"steps": 300, "channels": 24},
             {"steps": (100, 300)}, "Ma et al. 2025, TPAMI, smaller; learns each image by itself"),
)  # fmt: skip

REGISTRY: dict[str, Baseline] = {filter_.name: filter_ for filter_ in (*_FILTERS, *_RIVALS)}
"""All filters by name: those that users know, of other authors, and of packages in use."""
_BUILT_IN = frozenset(REGISTRY)
GROUPS = {
    "all": tuple(filter_.name for filter_ in _FILTERS),
    "rivals": tuple(filter_.name for filter_ in _RIVALS),
}
"""Names that stand for several filters."""


def register_method(method: Baseline) -> None:
    """Make a method known in this process, by its name among `baselines`.

    Raises ValueError for an object that is no method, and for a name that is taken or unusable.
    """
    if not isinstance(method, Baseline):
        raise ValueError(f"{method!r}: is a {type(method).__name__}; give a Baseline")
    if method.name in _BUILT_IN or method.name in GROUPS:
        raise ValueError(f"method {method.name!r}: there is one of that name")
    extensions.register("method", method.name, method)
    REGISTRY[method.name] = method


def method_of(name: str) -> Baseline:
    """The method of a name, of this project or another package.

    Raises FactoryError where there is none, and for one that cannot be loaded.
    """
    if name not in REGISTRY:
        method = extensions.find_of_type("method", name, Baseline)
        if method is None:
            known = dict.fromkeys((*REGISTRY, *extensions.names("method"), *GROUPS))
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"choose of {', '.join(known)}"
            raise FactoryError(f"baselines: no {name!r}; {hint}")
        REGISTRY[name] = method
    return REGISTRY[name]


def chosen(names: Sequence[str]) -> list[Baseline]:
    """The baselines of these names and groups, each once, in this order.

    Raises FactoryError that names an unknown one.
    """
    wanted: list[str] = []
    for name in names:
        wanted += GROUPS.get(name, (name,))
    return [method_of(name) for name in dict.fromkeys(wanted)]
