"""The page `reference/keys.md`: every configuration key of every verb that takes KEY=VALUE."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import get_args

from tools.pages.keys import Key, composed, conf_comments, keys

_HEAD = """\
# Configuration keys

*Written from the settings classes and `conf` when the site is built.*

The keys of every verb that takes `KEY=VALUE`. A *distribution* is a number, or
`{uniform: [low, high]}`, `{choice: [a, b]}` or `{normal: [mean, std]}`, drawn anew for each sample
([Configuration](../configuration.md#numbers-and-distributions)). `simnfnd VERB --cfg job` prints
all values as they are with the words given.
"""


@dataclass(frozen=True)
class Part:
    """A table of the page."""

    title: str
    keys: tuple[Key, ...]


def parts() -> Iterator[tuple[str, list[Part]]]:
    """The verbs, and the tables of each."""
    yield "simnfnd make", list(_make())
    yield "simnfnd train", list(_train())
    for verb, name, module, settings in (
        ("evaluate", "evaluation", "simnfnd.evaluation.settings", "EvaluationSettings"),
        ("evaluate real", "real", "simnfnd.evaluation.real.settings", "RealSettings"),
        ("evaluate realism", "realism", "simnfnd.evaluation.realism.settings", "RealismSettings"),
        ("evaluate fit", "fit", "simnfnd.evaluation.calibrate.settings", "FitSettings"),
    ):
        kind = getattr(import_module(module), settings)
        said = conf_comments((f"{name}.yaml", ""))
        if name == "fit":
            said["parameters"] = "what is searched, and its limits: the files of `conf/search`"
        found = keys(kind, composed(name), said)
        yield f"simnfnd {verb}", [Part("", tuple(found))]


def _make() -> Iterator[Part]:
    from simnfnd.factory.config import FactoryConfig
    from simnfnd.factory.noise.registry import FIELD_EFFECTS
    from simnfnd.factory.scenes import Scenes
    from simnfnd.factory.sonar_randomization.settings import DeviceSettings

    values = composed("factory")
    said = conf_comments(
        ("factory.yaml", ""),
        ("render/cycles.yaml", "render."),
        ("noise/simnfnd.yaml", "noise."),
        ("noise/physical.yaml", "noise."),
        ("resample/random.yaml", "resample."),
        ("sonar/camera_matched.yaml", "sonar."),
        ("water/sea.yaml", "water."),
        ("acoustics/points.yaml", "acoustics."),
        ("acoustics/field.yaml", "acoustics."),
        ("dataset/default.yaml", "dataset."),
        ("cache/default.yaml", "cache."),
        ("scheduler/local.yaml", "scheduler."),
        ("scheduler/dask.yaml", "scheduler."),
        ("devices/any_sonar.yaml", "devices."),
    )
    # Effects of the field have the values with which noise=physical switches them on.
    physical = composed("factory", "noise=physical", "acoustics=field")["noise"]
    values["noise"] |= {name: physical[name] for name in FIELD_EFFECTS if name in physical}
    drawn = composed("factory", "devices=any_sonar", "noise=any_sonar")["devices"]
    found = [
        key for key in keys(FactoryConfig, values, said) if key.name.split(".")[0] != "devices"
    ]
    groups = dict.fromkeys(key.name.split(".")[0] for key in found if "." in key.name)
    yield Part("", tuple(key for key in found if "." not in key.name))
    for kind in get_args(get_args(Scenes)[0]):
        name = kind.kind if hasattr(kind, "kind") else kind.__dataclass_fields__["kind"].default
        given = composed("factory", f"scenes={name}")["scenes"]
        texts = conf_comments((f"scenes/{name}.yaml", "scenes."))
        yield Part(f"scenes={name}", tuple(keys(kind, given, texts, "scenes.")))
    for group in groups:
        yield Part(group, tuple(key for key in found if key.name.startswith(f"{group}.")))
    yield Part("devices=any_sonar", tuple(keys(DeviceSettings, drawn, said, "devices.")))


def _train() -> Iterator[Part]:
    from simnfnd.models import settings
    from simnfnd.models.losses import LOSSES
    from simnfnd.models.networks import NETWORKS

    values = composed("models")
    said = conf_comments(("models.yaml", ""))
    groups = ("data", "model", "loss")
    found = [
        key
        for key in keys(settings.ModelsSettings, values, said)
        if key.name.split(".")[0] not in groups
    ]
    yield Part("", tuple(found))
    kinds = {
        "pairs": settings.PairsData,
        "renders": settings.RendersData,
        "olddata": settings.OldData,
        "self_supervised": settings.SelfSupervisedData,
    }
    for name, data in kinds.items():
        texts = {**said, **conf_comments((f"data/{name}.yaml", "data."))}
        given = composed("models", f"data={name}")["data"]
        yield Part(f"data={name}", tuple(keys(data, given, texts, "data.")))
    for name, (module, class_name, _) in NETWORKS.items():
        given = composed("models", f"model={name}")["model"]
        texts = conf_comments((f"model/{name}.yaml", "model."))
        one = getattr(import_module(module), class_name)
        yield Part(f"model={name}", tuple(keys(one, given, texts, "model.")))
    for name, loss in LOSSES.items():
        given = composed("models", f"loss={name}")["loss"]
        texts = conf_comments((f"loss/{name}.yaml", "loss."))
        yield Part(f"loss={name}", tuple(keys(loss, given, texts, "loss.")))


def markdown() -> str:
    """The page."""
    lines = [_HEAD]
    for verb, tables in parts():
        lines += [f"## {verb}", ""]
        for table in tables:
            lines += [f"### {verb.removeprefix('simnfnd ')}: {table.title}", ""] * bool(table.title)
            # Which of a group is chosen stands in the title.
            kinds = {key.name: key.meaning for key in table.keys if "=" in table.title}
            kind = kinds.get(f"{table.title.split('=')[0]}.kind")
            lines += [f"{kind[:1].upper()}{kind[1:]}.", ""] if kind else []
            lines += ["| key | meaning | default | may be |", "|---|---|---|---|"]
            lines += [
                f"| `{key.name}` | {key.meaning} | {key.default} | {key.allowed} |"
                for key in table.keys
                if "=" not in table.title or not key.name.endswith(".kind")
            ]
            lines.append("")
    return "\n".join(lines)
