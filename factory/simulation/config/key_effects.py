"""Rejects keys that the user names and that have no effect in the current configuration.

A device preset describes more of a sonar than one image formation uses, so only named keys count.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, NamedTuple

from ...common.errors import FactoryError
from ..noise.registry import blocks

if TYPE_CHECKING:
    from .root import FactoryConfig


class _Rule(NamedTuple):
    """Keys that act only while another key has one of some values.

    keys: patterns of dotted keys.  values: the first one is what an error suggests.
    """

    keys: tuple[str, ...]
    switch: str
    values: tuple[Any, ...]


_RULES = (
    _Rule(
        ("water", "water.*", "sonar.array", "sonar.array.*", "sonar.frequency_khz",
         "sonar.samples_per_bin", "sonar.transfer.full_scale_db"),
        "acoustics.formation", ("coherent",),
    ),
    _Rule(
        ("resample", "resample.*", "sonar.point_spread.*", "sonar.tvg_db_per_decade"),
        "acoustics.formation", ("pointwise",),
    ),
    _Rule(("sonar.transfer.percentile",), "sonar.transfer.full_scale_db", (None,)),
    _Rule(("sonar.transfer.exponent",), "sonar.transfer.kind", ("power",)),
    _Rule(("sonar.transfer.dynamic_range_db",), "sonar.transfer.kind", ("log", "soft_log")),
    _Rule(("sonar.image.*_px", "sonar.image.sampling"), "sonar.image.layout", ("fan",)),
    _Rule(("scenes.frames_per_location",), "scenes.path", (None,)),
    _Rule(("scenes.route", "scenes.paths", "scenes.views_per_path"), "scenes.poses", (None,)),
    _Rule(("scenes.distance_m",), "scenes.route", ("orbit",)),
    _Rule(("frames.stride", "frames.limit", "frames.total"), "frames.only", (None,)),
    _Rule(("split.test_fraction",), "split.test", ((),)),
    _Rule(("dataset.compression_level",), "dataset.compression", ("gzip",)),
)  # fmt: skip
# Only training images get the drawn height; a dataset keeps that of its images.
_KEPT = "sonar.image.height_px"
# Keys whose drawn counterpart in `devices` has another name.
_DRAWN_AS = {"range_bins": "bins_per_px", "kind": "log_share", "sampling": "nearest_share"}


def refuse_keys_without_effect(config: FactoryConfig, named: Iterable[str]) -> None:
    """Raise FactoryError, one line, for the first key that does nothing.

    named: dotted keys, and names of groups, that the user has given.
    """
    keys = list(named)
    for key in keys:
        if reason := reason_without_effect(config, key, keys):
            raise FactoryError(f"{key}: {reason}")


def reason_without_effect(
    config: FactoryConfig, key: str, named: Collection[str] = ()
) -> str | None:
    """Why a key does nothing under this configuration, and what to set instead; None if it acts.

    named: all keys that the user has given.
    """
    if key in ("sonar.range.min_m", "sonar.range.max_m"):
        if config.sonar.range.auto and "sonar.range.auto" not in named:
            return (
                "only limits the window, which sonar.range.auto=true fits to each frame; set "
                "sonar.range.auto=false for one window, or sonar.range.auto=true for a limit"
            )
    elif key.startswith("noise."):
        _, effect, *parameter = key.split(".")
        block = blocks(config.noise).get(effect)
        if block is not None and not block.enabled and parameter not in ([], ["enabled"]):
            return f"has no effect; set noise.{effect}.enabled=true, too, or leave it out"
    elif config.devices is not None and key.startswith(("sonar.", "acoustics.")) and key != _KEPT:
        name = key.rpartition(".")[2]
        drawn_as = _DRAWN_AS.get(name, name)
        if getattr(config.devices, drawn_as, None) is not None:
            return f"devices draws it for each image: set devices.{drawn_as}, or devices=fixed"
    elif config.devices is None:
        return _reason_of_rules(config, key)
    return None


def _reason_of_rules(config: FactoryConfig, key: str) -> str | None:
    for rule in _RULES:
        if not any(fnmatchcase(key, pattern) for pattern in rule.keys):
            continue
        value: Any = config
        for name in rule.switch.split("."):
            value = getattr(value, name, None)
        if value not in rule.values:
            wanted = {None: "null", (): "[]"}.get(rule.values[0], rule.values[0])
            return f"has no effect here; set {rule.switch}={wanted}, or leave it out"
    return None
