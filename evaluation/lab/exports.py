"""What the lab has found, for `simnfnd make`: words for the shell, a recipe, and a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ...factory.common.distribution import FORMS
from ...factory.common.errors import FactoryError
from ...factory.common.words import escape_interpolations, quote_if_needed, shell_line

RECIPE = "mine"
"""Name of the exported experiment."""
Values = Mapping[str, Any]


class Exports(NamedTuple):
    """What makes the images of the lab elsewhere.

    command: the line for the shell.  recipe: the YAML of an experiment.

    sweep: the line that makes a dataset of each value of the marked parameter; "" without one.
    """

    command: str
    recipe: str
    sweep: str


def command_line(words: Sequence[str], changes: Values) -> str:
    """`simnfnd make` with the words of the lab and the changed parameters."""
    return shell_line(["simnfnd", "make", *words, *change_words(changes)])


def sweep_line(words: Sequence[str], changes: Values, key: str, values: str) -> str:
    """`simnfnd make -m` with a parameter in several values.

    values: as `a,b,c`.  Raises FactoryError when there are fewer than two.
    """
    several = [value.strip() for value in values.split(",")]
    if len(several) < 2 or not all(several):
        raise FactoryError(f"sweep of {key}: give two or more values as a,b,c, got {values!r}")
    others = {name: value for name, value in changes.items() if name != key}
    sweep = f"{key}={','.join(several)}"
    return shell_line(["simnfnd", "make", "-m", *words, *change_words(others), sweep])


def change_words(changes: Values) -> list[str]:
    """`KEY=VALUE` for each change."""
    return [f"{key}={word_of(value)}" for key, value in changes.items()]


def word_of(value: Any) -> str:
    """A plain value in the grammar of the command line.

    Text is quoted, so that it means itself: text of a dataset may be a stranger's.
    """
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and value == int(value) and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, Mapping):
        items = (f"{word_of(str(key))}: {word_of(item)}" for key, item in value.items())
        return "{" + ", ".join(items) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(word_of, value)) + "]"
    return quote_if_needed(escape_interpolations(value)) if isinstance(value, str) else str(value)


class Base(NamedTuple):
    """What the words of the lab choose and set.

    groups: chosen ones, `experiment` among them.  settings: by dotted key.
    values: all values that the words mean.
    """

    groups: Mapping[str, str]
    settings: Values
    values: Values

    @classmethod
    def of(cls, overrides: Sequence[str], values: Values) -> Base:
        """Read the words of the lab.  overrides: words as Hydra reads them; see `compose`."""
        from hydra.core.override_parser.overrides_parser import OverridesParser

        groups = {}
        settings = {}
        for override in OverridesParser.create().parse_overrides(list(overrides)):
            key = override.key_or_group
            is_group = key == "experiment" or isinstance(values.get(key), Mapping)
            if is_group and isinstance(override.value(), str):
                groups[key] = str(override.value())
            else:
                settings[key] = override.value()
        return cls(groups, settings, values)


def recipe(base: Base, changes: Values) -> str:
    """The YAML of an experiment that means the same as `command_line`."""
    groups = dict(base.groups)
    defaults: list[Any] = []
    if experiment := groups.pop("experiment", ""):
        defaults.append(experiment)
    defaults += [{f"override /{group}": choice} for group, choice in groups.items()]
    defaults.append("_self_")

    body: dict[str, Any] = {}
    for key, value in {**base.settings, **changes}.items():
        set_dotted(body, key, _replacing(value, _value_at(base.values, key)))
    file = Path("presets", "experiment", f"{RECIPE}.yaml")
    head = (
        "# @package _global_\n"
        f"# simnfnd make --config-dir=presets experiment={RECIPE}\n"
        "#\n"
        f"# Of `simnfnd lab`; save it as {file}.\n"
    )
    text = yaml.safe_dump({"defaults": defaults, **body}, sort_keys=False, allow_unicode=True)
    return head + text


def set_dotted(values: dict[str, Any], key: str, value: Any) -> None:
    """Set the value of a dotted key in nested mappings, and add mappings that are missing."""
    *groups, name = key.split(".")
    for group in groups:
        values = values.setdefault(group, {})
    values[name] = value


def _value_at(values: Any, key: str) -> Any:
    for name in key.split("."):
        values = values.get(name) if isinstance(values, Mapping) else None
    return values


def _replacing(value: Any, before: Any) -> Any:
    """The value, with null for another form of distribution before it, which Hydra would merge."""
    if not isinstance(value, Mapping) or not isinstance(before, Mapping):
        return value
    removed_forms = {form: None for form in FORMS if form in before and form not in value}
    return {**removed_forms, **value}
