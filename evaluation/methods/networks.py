"""Trained networks as rows of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from ...factory.errors import FactoryError
from ...models import WEIGHTS_NAME
from ..filters.base import Gray
from ..settings import EvaluationSettings
from .method import Method

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry


def networks_of(settings: EvaluationSettings) -> list[Method]:
    """The rows of `models` and `ablation`, each named by its file or folder.

    Raises FactoryError for a path without weights.
    """
    ablation = {
        "olddata_l1": settings.ablation.olddata_l1,
        "simnfnd_l1": settings.ablation.simnfnd_l1,
        "simnfnd_newloss": settings.ablation.simnfnd_newloss,
    }
    auto = settings.models == "auto"
    return networks_at(shipped_for(settings) if auto else settings.models, ablation)


def shipped_for(settings: EvaluationSettings) -> list[str]:
    """Name of the weights that `simnfnd denoise` takes here; [] where nothing runs them."""
    if not all(map(find_spec, ("onnxruntime", "safetensors"))):
        return []
    from ...models.denoise.inputs import Item
    from ...models.denoise.shards import made_of_points
    from ...models.pretrained import DEFAULT, POINTS

    shard = next(Path(settings.dataset.dir).glob("*/shard-*.h5"), None)
    return [
        POINTS if shard is not None and made_of_points(Item(shard, Path(shard.name))) else DEFAULT
    ]


def networks_at(models: Sequence[str], ablation: Mapping[str, str | None]) -> list[Method]:
    """The same of these weights; `ablation`: row of the paper's Table 3 -> weights or None."""
    given = [(path, "", "models") for path in models]
    given += [(path, row, f"ablation.{row}") for row, path in ablation.items() if path]
    found: dict[Path, Method] = {}
    for text, row, key in given:
        path = _weights(Path(text).expanduser(), key)
        name = _name(path)
        taken = {method.name for method in found.values()}
        if path not in found and name in taken:
            name = next(f"{name}-{n}" for n in range(2, 1000) if f"{name}-{n}" not in taken)
        name = found[path].name if path in found else name
        found[path] = Method(name, "", {}, weights=str(path), ablation=row)
    return list(found.values())


class Network:
    """Trained weights as a method of the report: the noisy picture of an item in, denoised out."""

    def __init__(self, weights: str, device: str) -> None:
        """Raises FactoryError for a file that holds no weights of a network."""
        from ...models.denoise.denoiser import load_denoiser

        self.denoiser = load_denoiser(weights, device)

    @property
    def on_gpu(self) -> bool:
        """Whether it runs on a GPU."""
        return self.denoiser.runtime.on_gpu

    def __call__(self, image: Gray, geometry: FanGeometry | None = None) -> Gray:
        """(H, W) float32 in 0..1 -> the same, as `simnfnd denoise` makes it."""
        return self.denoiser(image, geometry if self.denoiser.runtime.extras else None)


@lru_cache(maxsize=2)
def network(weights: str, device: str) -> Network:
    """The network of a weights file, kept between pictures."""
    return Network(weights, device)


def costs_of(networks: Sequence[Method]) -> dict[str, dict[str, float]]:
    """Label -> gmac (for 256x256 pixels) and parameters of each network, as docs/models.md.

    Nothing without torch, which counts them.
    """
    if not networks or find_spec("torch") is None:
        return {}
    from ...models.networks.network import count_macs
    from ...models.networks.weights import load_weights

    found = {}
    for method in networks:
        assert method.weights is not None
        loaded = load_weights(method.weights).network
        found[method.label] = {
            "gmac": count_macs(loaded, 256) / 1e9,
            "parameters": float(sum(weights.numel() for weights in loaded.parameters())),
        }
    return found


def _weights(path: Path, key: str) -> Path:
    if path.is_dir():
        inside: Sequence[Path] = sorted(path.glob("*.safetensors"))
        best = path / WEIGHTS_NAME
        if best in inside:
            return best.resolve()
        if len(inside) == 1:
            return inside[0].resolve()
        if inside or not _ships(str(path)):
            raise FactoryError(
                f"{key}: {path} holds {len(inside)} weights files and no {WEIGHTS_NAME}; name a "
                "file"
            )
    if not path.is_file():
        from ...models.pretrained import find_weights

        try:
            path = find_weights(str(path))
        except FactoryError as error:
            raise FactoryError(f"{key}: {error}") from error
    return path.resolve()


def _ships(name: str) -> bool:
    """Whether weights of this name ship; a folder may have the same name."""
    from ...models.pretrained import find_weights

    try:
        find_weights(name)
    except FactoryError:
        return False
    return True


def _name(path: Path) -> str:
    return path.parent.name if path.name == WEIGHTS_NAME else path.stem
