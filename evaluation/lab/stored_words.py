"""A dataset's configuration in words of `simnfnd make`: what the lab starts from and exports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...factory.common.distribution import FORMS
from ...factory.simulation.config.compose import compose
from ...factory.simulation.config.key_effects import reason_without_effect
from ...factory.simulation.config.key_help import choices_of
from ...factory.simulation.config.named_keys import named_keys
from ...factory.simulation.config.root import plain
from ...factory.simulation.config.stored import stored_config
from .exports import word_of

if TYPE_CHECKING:
    from ...factory.simulation.config.root import FactoryConfig

_GROUPS = ("scenes", "render", "resample", "noise", "sonar", "water", "acoustics", "devices")
"""Groups that decide images; frames, split and files are up to whoever makes a dataset."""
_ABSENT = object()


def words_of_dataset(folder: Path) -> list[str]:
    """The words that make its frames again; what its file says is checked, and never executed.

    Raises FactoryError where its configuration cannot be read.
    """
    return words_of(stored_config(folder, compose([]).config))


def words_of(config: FactoryConfig) -> list[str]:
    """Choices of groups that come near to a configuration, then every key that differs."""
    chosen = _choices(config)
    start = compose(chosen).values
    stored = plain(config)
    words = [f"seed={config.seed}", f"dataset.dtype={config.dataset.dtype}"]
    for group in _GROUPS:
        words += _differing(group, stored[group], start.get(group))
    named = named_keys(words)
    acting = [
        word
        for word in words
        if reason_without_effect(config, word.lstrip("+").split("=")[0], named) is None
    ]
    return [*chosen, *acting]


def _choices(config: FactoryConfig) -> list[str]:
    """The words that choose the groups of a configuration, and keys that have no default."""
    device = config.sonar.name if config.sonar.name in choices_of("sonar") else "camera_matched"
    choices = {
        "scenes": config.scenes.kind,
        "render": config.render.kind,
        "noise": "none",
        "sonar": device,
        "acoustics": config.acoustics.formation,
        "devices": "fixed" if config.devices is None else "any_sonar",
    }
    words = [f"{group}={choice}" for group, choice in choices.items()]
    # These keys have no default, so the first composition needs them already.
    for key in ("root", "file", "intrinsics"):
        if (value := getattr(config.scenes, key, None)) is not None:
            words.append(f"scenes.{key}={word_of(value)}")
    return words


def _differing(key: str, value: Any, before: Any) -> Iterator[str]:
    """`KEY=VALUE` for each value that is not as before; `++KEY=VALUE` where there was none."""
    is_group = isinstance(value, Mapping) and not set(FORMS).intersection(value)
    if is_group:
        keys_before = before if isinstance(before, Mapping) else {}
        for name, inner in value.items():
            yield from _differing(f"{key}.{name}", inner, keys_before.get(name, _ABSENT))
    elif value != before:
        prefix = "++" if before is _ABSENT else ""
        yield f"{prefix}{key}={word_of(value)}"
