"""Words of the command line: what they mean as a configuration, and one line for a wrong one."""

from __future__ import annotations

import difflib
import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from ..errors import FactoryError

if TYPE_CHECKING:
    from ..config import FactoryConfig

_KEY = re.compile(r"[+]{0,2}[A-Za-z_][\w./@:-]*", re.ASCII)
# What Hydra's grammar reads as one value or several, and its own forms, which it explains itself.
_READS = re.compile(r"[A-Za-z0-9_./:@%+|*,-]*|[\[{'\"].*|.*\$\{.*|\w+\(.*", re.ASCII | re.DOTALL)


def compose_config(words: Sequence[str], scenes: Mapping[str, Any] | None = None) -> FactoryConfig:
    """The configuration of `simnfnd make WORDS`.  Raises FactoryError for a bad word.

    scenes: values of the group `scenes`, instead of those that the words mean.
    """
    single = [word for word in words if word not in ("-m", "--multirun")]
    ((_, config),) = compose_points(single, scenes)
    return config


def compose_points(
    words: Sequence[str], scenes: Mapping[str, Any] | None = None
) -> list[tuple[tuple[str, ...], FactoryConfig]]:
    """The points of a sweep (one without `-m`): what distinguishes each, and its configuration.

    Raises FactoryError for a bad word.
    """
    # Hydra brings antlr and plugins; those who only look at a folder must not pay for it.
    from hydra import compose, initialize_config_module
    from hydra.core.plugins import Plugins
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from ..config import composed_values, from_mapping
    from ..distribution import as_override

    sweep = any(word in ("-m", "--multirun") for word in words)
    overrides = [as_override(word) for word in readable(words) if not word.startswith("-")]
    try:
        with initialize_config_module("simnfnd.conf", version_base="1.3"):
            chosen_by_point = [overrides]
            if sweep:
                Plugins.instance()
                # Those that choose groups: enough to know what an experiment sweeps over.
                recipes = [word for word in overrides if word.startswith("experiment=")]
                root = compose("factory", overrides=recipes, return_hydra_config=True)
                # None in a plain sweep, a mapping where an experiment brings its own.
                chosen_by_point = sweep_points(overrides, dict(root.hydra.sweeper.params or {}))
            points = []
            for chosen in chosen_by_point:
                composed = compose("factory", overrides=chosen)
                if scenes is not None:
                    OmegaConf.set_struct(composed, False)
                    composed.scenes = dict(scenes)
                config = from_mapping(composed_values(composed))
                differs = [
                    word
                    for word, others in zip(chosen, zip(*chosen_by_point, strict=True), strict=True)
                    if len(set(others)) > 1
                ]
                points.append((tuple(differs), config))
            return points
    except (HydraException, OmegaConfBaseException) as error:
        raise FactoryError(config_line(error, "factory")) from error


def sweep_points(overrides: Sequence[str], params: Mapping[str, Any]) -> list[list[str]]:
    """The overrides of every point of a sweep, in Hydra's order: the last axis changes fastest.

    params: what an experiment sweeps over, where the words say nothing else.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    given = {word.split("=")[0] for word in overrides}
    more = [f"{key!s}={value}" for key, value in params.items() if key not in given]
    axes = [
        [f"{one.get_key_element()}={value}" for value in one.sweep_string_iterator()]
        if one.is_sweep_override()
        else [one.input_line or ""]
        for one in OverridesParser.create().parse_overrides([*more, *overrides])
    ]
    return [list(point) for point in itertools.product(*axes)]


def config_line(error: Exception, config_name: str) -> str:
    """Hydra's several lines in one, with the remedy."""
    if line := explained(str(error), config_name):
        return line
    reasons = [str(error)]
    if error.__cause__ is not None:
        reasons.append(str(error.__cause__))
    text = " ".join(" ".join(reasons).split())
    text = re.sub(r"\s*See https://hydra\S+ for details", "", text)
    return f"config: {text} (see `--cfg job` for every key)"


def readable(words: Sequence[str]) -> list[str]:
    """`words` with `~` at the start of a value expanded, and text that is no Hydra value quoted."""
    return [_readable(word) for word in words]


def _readable(word: str) -> str:
    key, equals, value = word.partition("=")
    if not equals or not _KEY.fullmatch(key):
        return word
    if value.startswith("~"):
        value = os.path.expanduser(value)
    if _READS.fullmatch(value):
        return f"{key}={value}"
    # Backslashes count only before a quote; one at the end would hide the closing one.
    text = re.sub(r"(\\*)'", lambda found: 2 * found[1] + "\\'", value)
    ends = "\\" * (len(text) - len(text.rstrip("\\")))
    return f"{key}='{text}{ends}'"


def explained(problem: str, name: str) -> str | None:
    """One line for a key or choice that Hydra does not know, with what is nearest; else None.

    problem: Hydra's message.  name: of the root configuration, conf/<name>.yaml.
    """
    if found := re.search(r"Could not find '([^'/]+)/([^']+)'", problem):
        group, choice = found[1], found[2]
        choices = sorted(_choices(group))
        near = [f"{group}={one}" for one in _near(choice, choices, 0.5)]
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(choices)}"
        return f"{group}={choice}: no such choice; {hint}"
    if found := re.search(r"Could not (?:override|delete from config\.) '([^']+)'", problem):
        key, keys = found[1], sorted(set(_keys(name)))
        if key in keys:
            return f"{key}: the chosen `{key.split('.')[0]}` has no such key (see `--cfg job`)"
        last = [one for one in keys if one.rpartition(".")[2] == key.rpartition(".")[2]]
        near = _near(key, keys, 0.7) or last[:3]
        hint = f"did you mean {' or '.join(near)}?" if near else "`--cfg job` shows every key"
        return f"{key}: no such key; {hint}"
    if found := re.search(r"Ambiguous value for argument '([^=]+)=", problem):
        return f"{found[1]}: several values are a sweep, `-m`, or a list, {found[1]}=[a,b]"
    return None


def _near(word: str, known: Sequence[str], cutoff: float) -> list[str]:
    """Those most like a word; one alone where that is a slip of a letter."""
    near = difflib.get_close_matches(word, known, cutoff=cutoff)
    slip = near and difflib.SequenceMatcher(None, word, near[0]).ratio() > 0.9
    return near[:1] if slip else near


def _choices(group: str) -> list[str]:
    folder = files("simnfnd.conf").joinpath(group)
    names = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
    return [name.removesuffix(".yaml") for name in names if name.endswith(".yaml")]


def _keys(name: str) -> Iterator[str]:
    """Dotted keys of a root configuration and of every choice of its groups, and the groups."""
    root = _load(f"{name}.yaml")
    yield from _flat({key: value for key, value in root.items() if key != "hydra"})
    groups = [next(iter(entry)) for entry in root.get("defaults", ()) if isinstance(entry, dict)]
    for group in (group for group in groups if " " not in group):
        yield group
        for choice in _choices(group):
            yield from _flat(_load(f"{group}/{choice}.yaml"), f"{group}.")


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in values.items():
        if key != "defaults":
            yield f"{prefix}{key}"
            if isinstance(value, dict):
                yield from _flat(value, f"{prefix}{key}.")


def _load(path: str) -> dict[str, Any]:
    import yaml

    text = files("simnfnd.conf").joinpath(path).read_text(encoding="utf-8")
    values = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)) or {}
    # An experiment sets keys of others.
    return {} if "# @package _global_" in text and "/" in path else dict(values)
