"""The rows of a report before they are measured: baselines in their forms, and networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...factory.common.errors import FactoryError
from ...factory.common.files import real_path
from ...models import WEIGHTS_NAME
from ..filters import Baseline, Parameters, chosen
from ..metrics.measure import Levels
from .settings import EvaluationSettings

if TYPE_CHECKING:
    from ...models.denoise.denoiser import Denoiser

FAST = ("median", "gaussian", "bilateral", "nlm", "grey_opening")
GROUPS = {"fast": FAST, "paper": (*FAST, "bm3d")}
"""Names that stand for several baselines: those of the paper's Table 2, and grey opening."""


@dataclass(frozen=True)
class Method:
    """A row before it is measured.

    name: of the baseline in the registry, or of a network.
    form: '', 'tuned', '+ levels' or 'tuned + levels'.
    folds: parameters for the subjects of each fold, where they differ.
    weights: of a network, else None.
    images_source: the folder of another program's images; else ''.
    ablation: which row of the paper's Table 3 a network is, or ''.
    """

    name: str
    form: str
    parameters: Parameters
    levels: Levels | None = None
    weights: str | None = None
    ablation: str = ""
    images_source: str = ""
    folds: tuple[Parameters, ...] = ()

    def parameters_of(self, fold: int) -> Parameters:
        """The parameters for the subjects of a fold."""
        return self.folds[fold] if self.folds else self.parameters

    @property
    def label(self) -> str:
        """The name of the row."""
        name = "noisy" if self.name == "identity" else self.name
        return f"{name} {self.form}".strip()

    @property
    def kind(self) -> str:
        """What made it: noisy (nothing), baseline, network, or images (of another program)."""
        if self.name == "identity" and not self.form:
            return "noisy"
        if self.images_source:
            return "pictures"
        return "baseline" if self.weights is None else "network"

    @property
    def output(self) -> str:
        """Equal for rows that differ in their levels alone, so that they share the filtering."""
        source = self.images_source or self.weights or self.name
        return f"{source} {self.form if self.folds else sorted(self.parameters.items())}"


NOISY = Method("identity", "", {})


def baselines_of(names: Sequence[str]) -> list[Baseline]:
    """The baselines of `baselines=[...]`, groups of names spelt out."""
    return chosen([baseline for name in names for baseline in GROUPS.get(name, (name,))])


def methods_of(baselines: Sequence[Baseline], tuned: Mapping[str, Any]) -> list[Method]:
    """The rows of the baselines: by default, and in the forms that the tuned file has."""
    methods = [NOISY]
    for baseline in baselines:
        methods.append(Method(baseline.name, "", dict(baseline.default)))
        if baseline.name not in tuned:
            continue
        forms = [("+ levels", "default")]
        if baseline.grid:
            forms += [("tuned", "tuned"), ("tuned + levels", "tuned_levels")]
        for form, key in forms:
            point = tuned[baseline.name][key]
            levels = Levels(**point["levels"]) if form.endswith("levels") else None
            methods.append(Method(baseline.name, form, point["parameters"], levels))
    return list({method.label: method for method in methods}.values())


def networks_of(settings: EvaluationSettings) -> list[Method]:
    """The rows of `models` and `ablation`, each named by its file or folder.

    Raises FactoryError for a path without weights.
    """
    auto = settings.models == "auto"
    models = shipped_for(Path(settings.dataset.dir)) if auto else settings.models
    ablation = {str(row): weights for row, weights in settings.ablation.items()}
    return networks_at(models, ablation)


def shipped_for(dataset: Path) -> list[str]:
    """Name of the weights that `simnfnd denoise` takes here; [] where nothing runs them."""
    if not all(map(find_spec, ("onnxruntime", "safetensors"))):
        return []
    from ...factory.dataset.layout import config_of
    from ...models.denoise.shards import made_of_points, opened_shard
    from ...models.pretrained import DEFAULT, POINTS

    shard = next(dataset.glob("*/shard-*.h5"), None)
    if shard is None:
        return [DEFAULT]
    with opened_shard(shard) as opened:
        return [POINTS if made_of_points(config_of(opened)) else DEFAULT]


def networks_at(
    models: Sequence[str], ablation: Mapping[str, str | None] | None = None
) -> list[Method]:
    """Methods of these networks; `ablation`: row of the paper's Table 3 -> weights or None."""
    requested = [(path, "", "models") for path in models]
    requested += [(path, row, f"ablation.{row}") for row, path in (ablation or {}).items() if path]
    methods: dict[Path, Method] = {}
    for text, row, key in requested:
        path = _weights(Path(text).expanduser(), key)
        name = path.parent.name if path.name == WEIGHTS_NAME else path.stem
        if any(method.name == name for known_path, method in methods.items() if known_path != path):
            name = str(path)
        methods[path] = Method(name, "", {}, weights=str(path), ablation=row)
    return list(methods.values())


@lru_cache(maxsize=2)
def network(weights: str, device: str) -> Denoiser:
    """The network of a weights file, kept between images.

    Raises FactoryError for a file that holds no weights of a network.
    """
    from ...models.denoise.denoiser import Denoiser

    return Denoiser(weights, device)


def reason(error: Exception) -> str:
    """Why a method failed, in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, FactoryError) else f"{type(error).__name__}: {text}"


def shown(parameters: Parameters) -> str:
    """Parameters in brackets, nothing for none."""
    parts = [f"{name}={value:.3g}" for name, value in parameters.items()]
    return f" ({', '.join(parts)})" if parts else ""


def _weights(path: Path, key: str) -> Path:
    """The weights file that is meant: in a folder of a training, a file, or one that ships."""
    from ...models.pretrained import find_weights

    try:
        return real_path(find_weights(path))
    except FactoryError as error:
        raise FactoryError(f"{key}: {error}") from error
