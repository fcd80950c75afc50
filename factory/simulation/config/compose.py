"""Words of the command line: what they mean as a configuration, and one line for a wrong one."""

from __future__ import annotations

import difflib
import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...common import extensions
from ...common.distribution import as_override
from ...common.errors import FactoryError
from ...common.small_files import load_yaml
from ...common.words import quote
from .hydra_loader import config_folders, load, searched_folders, take_config_folders
from .text_keys import TextKey, hydra_value, text_keys

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from .root import FactoryConfig

_SWEEP = ("-m", "--multirun")
_KEY = re.compile(r"[+]{0,2}[A-Za-z_][\w./@:-]*", re.ASCII)
# Folders of Hydra itself.
_HYDRA_FOLDER = re.compile(r"hydra\.(run|sweep)\.(dir|subdir)")
# What Hydra's grammar reads as one value or several, and its own forms, which it explains itself.
_READS = re.compile(r"[A-Za-z0-9_./:@%+|*,-]*|[\[{'\"].*|.*\$\{.*|\w+\(.*", re.ASCII | re.DOTALL)


def compose_config(words: Sequence[str], scenes: Mapping[str, Any] | None = None) -> FactoryConfig:
    """The configuration of `simnfnd make WORDS`.  Raises FactoryError for a bad word.

    Works inside another Hydra application and in threads.
    scenes: values of the group `scenes`, instead of those that the words mean.
    """
    with _one_line_errors([word for word in words if word not in _SWEEP]) as readable:
        overrides = [word for word in readable if not word.startswith("-")]
        return _compose(overrides, scenes).config


def compose_points(words: Sequence[str]) -> list[FactoryConfig]:
    """The configurations of a sweep's points, one where neither `-m` nor a recipe sweeps.

    Raises FactoryError for a bad word.
    """
    from hydra.types import RunMode

    with _one_line_errors(words) as readable:
        overrides = [word for word in readable if not word.startswith("-")]
        # Words that choose a recipe: enough to know what an experiment sweeps over.
        recipes = [word for word in overrides if word.startswith("experiment=")]
        points = [overrides]
        composed: DictConfig | None = None
        is_sweep = any(word in _SWEEP for word in words)
        if is_sweep or recipes:
            root = load("factory", recipes)
            # None in a plain sweep, a mapping where an experiment brings its own.
            if is_sweep or root.hydra.mode == RunMode.MULTIRUN:
                points = sweep_points(overrides, dict(root.hydra.sweeper.params or {}))
            elif overrides == recipes:
                composed = root
        return [_compose(point, composed=composed).config for point in points]


class Composition(NamedTuple):
    """The configuration that words mean, and what it was built from.

    values: plain ones, as the YAML files and words give them.  config: the same, validated.
    overrides: the words as Hydra reads them.
    pins: words that fix, in a sweep, what the experiment itself would sweep over.
    """

    values: dict[str, Any]
    config: FactoryConfig
    overrides: list[str]
    pins: list[str]


def compose(words: Sequence[str]) -> Composition:
    """Compose as `compose_config` does; also returns the values behind the configuration."""
    with _one_line_errors(words) as readable:
        return _compose([word for word in readable if not word.startswith("-")])


def _compose(
    overrides: list[str],
    scenes: Mapping[str, Any] | None = None,
    composed: DictConfig | None = None,
) -> Composition:
    """Compose and check a configuration.

    scenes: values that replace the group, for frames in memory.  composed: what Hydra makes of
    the overrides, where that is known.
    """
    from omegaconf import OmegaConf, open_dict

    from .key_effects import refuse_keys_without_effect
    from .named_keys import named_keys
    from .root import composed_values, from_mapping

    if composed is None:
        composed = load("factory", overrides)
    pins = _pins(composed, overrides)
    with open_dict(composed):
        del composed["hydra"]
    if scenes is not None:
        OmegaConf.set_struct(composed, False)
        composed.scenes = dict(scenes)
    values = composed_values(composed)
    config = from_mapping(values)
    refuse_keys_without_effect(config, named_keys(overrides))
    return Composition(values, config, overrides, pins)


def _pins(composed: DictConfig, overrides: Sequence[str]) -> list[str]:
    from omegaconf import OmegaConf

    named = {word.split("=")[0] for word in overrides}
    choices = composed.hydra.runtime.choices
    swept = [str(key) for key in composed.hydra.sweeper.params or {} if str(key) not in named]
    return [f"{key}={choices.get(key, OmegaConf.select(composed, key))}" for key in swept]


@contextmanager
def _one_line_errors(words: Sequence[str]) -> Iterator[list[str]]:
    """Gives the words in Hydra's grammar; what Hydra raises inside becomes a FactoryError."""
    # Hydra brings antlr and plugins; those who only look at a folder must not pay for it.
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from .root import FactoryConfig

    settings, folders = take_config_folders(words)
    readable = hydra_words(settings, "factory", FactoryConfig)
    with config_folders(folders):
        try:
            yield readable
        except (HydraException, OmegaConfBaseException) as error:
            raise FactoryError(config_line(error, "factory")) from error


def sweep_points(overrides: Sequence[str], params: Mapping[str, Any]) -> list[list[str]]:
    """The overrides of every point of a sweep, in Hydra's order: the last axis changes fastest.

    params: what an experiment sweeps over, where the words say nothing else.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    given_keys = {word.split("=")[0] for word in overrides}
    more = [f"{key!s}={value}" for key, value in params.items() if key not in given_keys]
    axes = [
        [f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()]
        if override.is_sweep_override()
        else [override.input_line or ""]
        for override in OverridesParser.create().parse_overrides([*more, *overrides])
    ]
    return [list(point) for point in itertools.product(*axes)]


def config_line(error: Exception, name: str) -> str:
    """One line for what Hydra says in several, with what is nearest to an unknown key or choice.

    name: of the root configuration, conf/<name>.yaml.
    """
    from ..imaging.settings import formation_of

    text = " ".join(f"{error} {error.__cause__ or ''}".split())
    if match := re.search(
        r"Could not find '([^'/]+)/([^']+)' Available options in '.*?': (.*)", text
    ):
        group = match[1]
        choice = match[2]
        choices = re.sub("Config search path.*", "", match[3]).split()
        near = [
            f"{group}={name_of_choice}"
            for name_of_choice in difflib.get_close_matches(choice, choices, n=2)
        ]
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(choices)}"
        return f"{group}={choice}: no such choice; {hint}"
    if match := re.search(r"Could not (?:override|delete from config\.) '([^']+)'", text):
        key = match[1]
        keys = sorted(_keys(name))
        if key in keys:
            if formation := formation_of(key):
                return f"{key}: set acoustics={formation}, whose setting it is, or leave it out"
            return f"{key}: the chosen `{key.split('.')[0]}` has no such key (see `--cfg job`)"
        from .root import GONE_KEYS

        if key in GONE_KEYS:
            return f"{key}: {GONE_KEYS[key]}"
        last = [
            name_of_choice
            for name_of_choice in keys
            if name_of_choice.rpartition(".")[2] == key.rpartition(".")[2]
        ]
        near = difflib.get_close_matches(key, keys, n=1, cutoff=0.7) or last[:3]
        hint = f"did you mean {' or '.join(near)}?" if near else "`--cfg job` shows every key"
        return f"{key}: no such key; {hint}"
    if match := re.search(r"Ambiguous value for argument '([^=]+)=", text):
        return f"{match[1]}: several values are a sweep, `-m`, or a list, {match[1]}=[a,b]"
    if match := re.search(r"(?:no viable alternative at|mismatched|extraneous) input '(.*)'", text):
        return (
            f"config: cannot read {match[1]}; put names and paths inside of lists and mappings in "
            "quotes, such as {file: 'dive (2).glb'}"
        )
    if match := re.search(r"Error parsing override '([^']+)' missing EQUAL", text):
        return f"{match[1]}: not KEY=VALUE; see `--help`"
    text = re.sub(r"\s*See https://hydra\S+ for details", "", text)
    return f"config: {text} (see `--cfg job` for every key)"


def _keys(name: str) -> set[str]:
    """Dotted keys of a root configuration and of all choices of groups, and the groups."""
    own = Path(str(files("simnfnd.conf")))
    keys = set(_flat(load_yaml(own / f"{name}.yaml"), ""))
    for folder in (own, *searched_folders()):
        for path in folder.glob("*/*.yaml"):
            group = path.parent.name
            if group != "experiment":  # which sets keys of others
                keys |= {group, *_flat(load_yaml(path) or {}, f"{group}.")}
    from ..noise.registry import own_effects

    for effect in own_effects():
        parameters = (item.name for item in effect.parameters)
        keys |= {f"noise.{effect.name}.{item}" for item in ("enabled", *parameters)}
    return keys


def _flat(values: Mapping[str, Any], prefix: str) -> Iterator[str]:
    for key, value in values.items():
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")


def hydra_words(words: Sequence[str], name: str, settings: Any) -> list[str]:
    """Words of the command line in Hydra's grammar.

    Values of keys that hold text are names and paths as they stand; `~` at their start is the home
    folder.  name: of the root configuration, conf/<name>.yaml.  settings: its class.
    """
    texts = text_keys(settings)
    in_sweep = any(word in _SWEEP for word in words)
    return [_hydra_word(word, name, texts, in_sweep=in_sweep) for word in words]


def own_effect_key(key: str) -> str:
    """A key of an effect of another package, of which no YAML file need have a block."""
    parts = key.split(".")
    is_own = parts[0] == "noise" and len(parts) > 2 and parts[1] in extensions.names("effect")
    return f"++{key}" if is_own else key


def _hydra_word(word: str, name: str, texts: Mapping[str, TextKey], *, in_sweep: bool) -> str:
    """A word of the command line as Hydra's grammar has it: texts quoted, paths expanded.

    name: of the root configuration.  texts: its keys that hold text.
    """
    key, equals, value = word.partition("=")
    if not equals or not _KEY.fullmatch(key):
        return word
    if name == "factory":
        key = own_effect_key(key)
    if value.startswith("~"):
        value = os.path.expanduser(value)

    path = key.lstrip("+")
    text_key = TextKey(is_list=False) if _HYDRA_FOLDER.fullmatch(path) else texts.get(path)
    if text_key is not None:
        roots = frozenset[str]()
        if "${" in value:
            roots = frozenset(known.partition(".")[0] for known in _keys(name)) | {"hydra"}
        return f"{key}={hydra_value(value, text_key, in_sweep=in_sweep, roots=roots)}"
    if not _READS.fullmatch(value):
        return f"{key}={quote(value)}"
    return as_override(f"{key}={value}") if name == "factory" else f"{key}={value}"
