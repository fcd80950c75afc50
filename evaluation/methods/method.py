"""The rows of the report before they are measured: baselines in their forms, and networks."""

from __future__ import annotations

import hashlib
import inspect
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...factory.errors import FactoryError
from ...factory.files import sha256_of
from ..filters import REGISTRY, chosen
from ..filters import base as base_module
from ..filters.base import Baseline, Parameters
from ..metrics.levels import Levels

FAST = ("median", "gaussian", "bilateral", "nlm", "grey_opening")
GROUPS = {"fast": FAST, "paper": (*FAST, "bm3d")}
"""Names that stand for several baselines: those of the paper's Table 2, and grey opening."""


@dataclass(frozen=True)
class Method:
    """A row before it is measured.

    name: of the baseline in the registry, or of a network.
    form: '', 'tuned', '+ levels' or 'tuned + levels'.
    weights: of a network, else None.
    given: what gives its pictures, where it is no function: the folder of another program's, or
        what a subject knows by this word.  content: changes with those pictures.
    ablation: which row of the paper's Table 3 a network is, or ''.
    """

    name: str
    form: str
    parameters: Parameters
    levels: Levels | None = None
    weights: str | None = None
    ablation: str = ""
    given: str = ""
    content: str = ""

    @property
    def label(self) -> str:
        """The name of the row."""
        name = "noisy" if self.name == "identity" else self.name
        return f"{name} {self.form}".strip()

    @property
    def looks(self) -> bool:
        """Whether it sees several pictures of a scene at once."""
        known = None if self.given or self.weights else REGISTRY.get(self.name)
        return known is not None and known.looks

    @property
    def is_function(self) -> bool:
        """Whether it is something to run on a picture."""
        return not self.given

    @property
    def uses_geometry(self) -> bool:
        """Whether it may ask where range and bearing are."""
        return self.kind == "network" or REGISTRY[self.name].uses_geometry

    @property
    def kind(self) -> str:
        """What made it: noisy (nothing), baseline, network, or pictures (of another program)."""
        if self.is_noisy:
            return "noisy"
        if self.given:
            return "pictures"
        return "network" if self.weights is not None else "baseline"

    @property
    def is_noisy(self) -> bool:
        """Whether this is the noisy image as it is."""
        return self.name == "identity" and not self.form

    @property
    def output(self) -> str:
        """Equal for rows that differ in their levels alone, so that they share the filtering."""
        source = self.given or self.weights or self.name
        return f"{source} {sorted(self.parameters.items())}"

    @property
    def key(self) -> str:
        """Changes with everything that decides the row's figures, but the pictures."""
        if self.given:
            program = self.content
        elif self.weights is not None:
            program = weights_digest(self.weights)
        else:
            program = program_of(REGISTRY[self.name])
        levels = None if self.levels is None else [self.levels.gain, self.levels.offset]
        parts = [self.name, sorted(self.parameters.items()), levels, program]
        return hashlib.blake2b(json.dumps(parts).encode(), digest_size=12).hexdigest()


NOISY = Method("identity", "", {})


def baselines_of(names: Sequence[str]) -> list[Baseline]:
    """The baselines of `baselines=[...]`, groups of names spelt out."""
    spelt = [one for name in names for one in GROUPS.get(name, (name,))]
    return chosen(spelt)


def methods_of(baselines: Sequence[Baseline], tuned: dict[str, Any]) -> list[Method]:
    """The rows of the baselines: by default, and in the forms that the tuned file has."""
    methods = [NOISY]
    for baseline in baselines:
        methods.append(Method(baseline.name, "", dict(baseline.default)))
        entry = tuned.get(baseline.name)
        if entry is None:
            continue
        forms = [("+ levels", "default")]
        if baseline.grid:
            forms += [("tuned", "tuned"), ("tuned + levels", "tuned_levels")]
        for form, key in forms:
            point = entry[key]
            levels = Levels(**point["levels"]) if form.endswith("levels") else None
            methods.append(Method(baseline.name, form, point["parameters"], levels))
    return list({method.label: method for method in methods}.values())


def program_of(baseline: Baseline) -> str:
    """Changes with the program of a baseline."""
    return _digest(baseline.program() + inspect.getsource(base_module))


@lru_cache(maxsize=64)
def weights_digest(path: str) -> str:
    """Changes with the weights."""
    return sha256_of(Path(path))[:24]


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def reason(error: Exception) -> str:
    """Why a method failed, in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, FactoryError) else f"{type(error).__name__}: {text}"


def shown(parameters: Parameters) -> str:
    """Parameters in brackets, nothing for none."""
    parts = [f"{name}={_rounded(value)}" for name, value in parameters.items()]
    return f" ({', '.join(parts)})" if parts else ""


def _rounded(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else str(value)
