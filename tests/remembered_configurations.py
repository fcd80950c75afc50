"""What Hydra has read, ordered and merged is kept: 25 files at each of a thousand compositions.

A composition takes a fraction of its CPU time.  Only files of `simnfnd.conf` and Hydra's own,
which do not change, are kept; where a test adds folders or packages to search, all is read anew.
"""

from __future__ import annotations

import copy
from typing import Any

from hydra._internal import defaults_list
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra.core.object_type import ObjectType

_UNCHANGING = ("simnfnd.conf", "hydra.conf")
_NOTES = ("override_choices", "override_metadata", "known_choices", "known_choices_per_group")
_files: dict[tuple[str, str], Any] = {}
_compositions: dict[str, Any] = {}
_lists: dict[tuple[Any, ...], tuple[Any, dict[str, Any]]] = {}
_load_config = ConfigRepository.load_config
_compose = ConfigLoaderImpl._compose_config_from_defaults_list
_order = defaults_list._create_defaults_list


class _Copies:
    """A repository whose answers may be changed, as Hydra does when it merges them."""

    def __init__(self, repository: Any) -> None:
        self._repository = repository

    def load_config(self, config_path: str) -> Any:
        return copy.deepcopy(self._repository.load_config(config_path))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._repository, name)


def _is_unchanging(source: Any) -> bool:
    # By its scheme, because Hydra loads the module of a source again when it looks for plugins.
    is_package = source.scheme() == "pkg" and source.path in _UNCHANGING
    return source.scheme() == "structured" or is_package


def _load_remembered(self: ConfigRepository, config_path: str) -> Any:
    source = self._find_object_source(config_path, ObjectType.CONFIG)
    if source is None or source.scheme() == "structured" or not _is_unchanging(source):
        return _load_config(self, config_path)
    key = (source.path, config_path)
    if key not in _files:
        _files[key] = _load_config(self, config_path)
    return copy.copy(_files[key])


def _compose_remembered(self: ConfigLoaderImpl, defaults: Any, repo: Any) -> Any:
    if not all(_is_unchanging(source) for source in repo.get_sources()):
        return _compose(self, defaults, _Copies(repo))  # type: ignore[arg-type]
    key = str(defaults)
    if key not in _compositions:
        _compositions[key] = _compose(self, defaults, _Copies(repo))  # type: ignore[arg-type]
    return copy.deepcopy(_compositions[key])


def _order_remembered(
    repo: Any, config_name: str | None, overrides: Any, prepend_hydra: bool, skip_missing: bool
) -> Any:
    """The files of a composition in order, and their tree; `overrides` notes which were used."""
    is_plain = not overrides.append_group_defaults and not overrides.deletions
    if not is_plain or not all(_is_unchanging(source) for source in repo.get_sources()):
        return _order(repo, config_name, overrides, prepend_hydra, skip_missing)
    choices = str(sorted(overrides.override_choices.items()))
    key = (config_name, prepend_hydra, skip_missing, choices)
    if key not in _lists:
        ordered = _order(repo, config_name, overrides, prepend_hydra, skip_missing)
        notes = {name: vars(overrides)[name] for name in _NOTES}
        _lists[key] = ordered, copy.deepcopy(notes)
    ordered, notes = _lists[key]
    vars(overrides).update(copy.deepcopy(notes))
    return ordered


def remember(patch: Any) -> None:
    """From now on, until the patch is undone."""
    patch.setattr(ConfigRepository, "load_config", _load_remembered)
    patch.setattr(ConfigLoaderImpl, "_compose_config_from_defaults_list", _compose_remembered)
    patch.setattr(defaults_list, "_create_defaults_list", _order_remembered)


def forget(patch: Any) -> None:
    """Have Hydra read all files, until the patch is undone."""
    patch.setattr(ConfigRepository, "load_config", _load_config)
    patch.setattr(ConfigLoaderImpl, "_compose_config_from_defaults_list", _compose)
    patch.setattr(defaults_list, "_create_defaults_list", _order)
