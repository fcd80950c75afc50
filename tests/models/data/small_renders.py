"""Settings of training data, and a small dataset of the factory with its renders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.factory.common.settings import build
from simnfnd.factory.production.cli.generate import run
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.pairs.views import CachedViews
from simnfnd.factory.simulation.render.pack import write_pack
from simnfnd.models.data.pairs import ImageSource
from simnfnd.models.data.renders import DeviceSource, RenderSource
from simnfnd.models.data.sources import open_data
from simnfnd.models.data.time_stacks import MixedSource
from simnfnd.models.settings import DataSettings, ModelsSettings

WORDS = (
    *("experiment=simnfnd", "scenes=seabed", "scenes.locations=4", "scenes.frames_per_location=1"),
    *("scenes.width=160", "scenes.height=100", "render=analytic", "split.test=[]"),
    *("sonar.image.width_px=48", "sonar.image.height_px=40", "sonar.beams=48"),
    *("sonar.range_bins=40", "scheduler=serial", "scenes.objects=0.2", "dataset.preview_pairs=0"),
)


def rendered_dataset(folder: Path) -> tuple[Path, Path]:
    """A dataset of the factory, and a pack of its renders."""
    dataset = folder / "data"
    pack = folder / "views.pack"
    config = compose_config([*WORDS, f"dataset.dir='{dataset}'", f"cache.dir='{folder / 'cache'}'"])
    report, _ = run(config, [])
    views = CachedViews(config)
    from simnfnd.factory.simulation.scenes import open_reader

    frames = open_reader(config.scenes).discover().frames
    write_pack(pack, frames, views.view, config.sonar.mount, config.render)
    assert not report.failures
    return dataset, pack


def renders(rendered: tuple[Path, Path], **changes: Any) -> RenderSource:
    """The dataset's own device and noise."""
    source = _opened(rendered, "renders", changes)
    assert isinstance(source, RenderSource)
    return source


def drawn_devices(rendered: tuple[Path, Path], **changes: Any) -> DeviceSource:
    """Drawn devices on the same renders."""
    source = _opened(rendered, "mixed", changes)
    assert isinstance(source, MixedSource)
    assert isinstance(source.devices, DeviceSource)
    return source.devices


def _opened(rendered: tuple[Path, Path], kind: str, changes: dict[str, Any]) -> ImageSource:
    data_options = {"pack": str(rendered[1]), "validation": 0.3, **changes}
    settings, _ = composed(f"data={kind}", f"dataset.dir='{rendered[0]}'", "data.patch=32")
    data = replace(settings.data, **data_options)
    return open_data(replace(settings, data=data, seed=5)).learning


SMALL = (
    *("model=nafnet", "model.width=4", "model.encoder=[1]", "model.decoder=[1]"),
    *("data.patch=32", "data.batch=4"),
    *("train.steps=6", "train.check_every=2", "train.warmup=2", "train.ema=0.5"),
    "data.workers=0",
)


def data_settings(kind: str = "pairs", **changes: Any) -> DataSettings:
    return replace(composed(f"data={kind}")[0].data, **changes)


def composed(*words: str) -> tuple[ModelsSettings, dict[str, Any]]:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("models", list(words)), resolve=True)
    return build(ModelsSettings, values), values
