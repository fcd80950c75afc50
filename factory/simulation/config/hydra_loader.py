"""Composition of configurations by Hydra without its global state.

`hydra.compose` works on one global instance, which another Hydra application in the same process
owns.  The loader below it needs none, so that a configuration of ours can be composed inside any
application, in notebooks and in threads.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

from ...common import extensions
from ...common.errors import FactoryError
from ...common.private_apis import hydra_loader

if TYPE_CHECKING:
    from omegaconf import DictConfig

OPTIONS = ("--config-dir", "-cd")
_CONFIG_MODULE = "pkg://simnfnd.conf"
_VERSION_BASE = "1.3"

# Hydra's registry of plugins and its version base are global.
_lock = threading.RLock()
_config_folders: ContextVar[tuple[Path, ...]] = ContextVar("config_folders", default=())


@contextmanager
def config_folders(folders: Sequence[Path]) -> Iterator[None]:
    """Search these folders for choices of groups, too, in every composition inside the block."""
    absolute = (folder.absolute() for folder in folders)
    token = _config_folders.set(tuple(dict.fromkeys((*_config_folders.get(), *absolute))))
    try:
        yield
    finally:
        _config_folders.reset(token)


def searched_folders() -> tuple[Path, ...]:
    """The folders of `config_folders` that are in force."""
    return _config_folders.get()


def config_folder_words() -> list[str]:
    """The words that put `searched_folders` in force again."""
    return [f"{OPTIONS[0]}={folder}" for folder in searched_folders()]


def take_config_folders(words: Sequence[str]) -> tuple[list[str], list[Path]]:
    """Separate `--config-dir DIR` and `--config-dir=DIR` from the other words.

    Raises FactoryError for a folder that is not there, or not named.
    """
    others: list[str] = []
    folders: list[Path] = []
    remaining = iter(words)
    for word in remaining:
        name, equals, value = word.partition("=")
        if name not in OPTIONS:
            others.append(word)
            continue
        folder = Path(value if equals else next(remaining, "")).expanduser()
        if not folder.name or not folder.is_dir():
            raise FactoryError(
                f"{name}={value or folder}: no such folder; give one that holds folders such as "
                "sonar/ or noise/ with YAML files"
            )
        folders.append(folder)
    return others, folders


def register_search_path() -> None:
    """Have Hydra look for choices in `searched_folders` and in the presets of other packages."""
    from hydra.core.config_search_path import ConfigSearchPath
    from hydra.core.plugins import Plugins
    from hydra.plugins.search_path_plugin import SearchPathPlugin

    with _lock:
        plugins = Plugins.instance()
        if any(
            plugin.__name__ == "SimnfndFolders" for plugin in plugins.discover(SearchPathPlugin)
        ):
            return

        class SimnfndFolders(SearchPathPlugin):
            def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
                for folder in searched_folders():
                    search_path.append("simnfnd --config-dir", f"file://{folder}")
                for name in extensions.names("preset"):
                    module = extensions.preset_module(name)
                    search_path.append(f"simnfnd preset {name}", f"pkg://{module}")
                _store_readers()

        plugins.register(SimnfndFolders)


def _store_readers() -> None:
    """Make `scenes=KIND` a choice of Hydra for each reader of another package."""
    from hydra.core.config_store import ConfigStore

    from ..scenes import default_values

    for kind in extensions.names("reader"):
        # What cannot be loaded is reported when it is chosen.
        with suppress(FactoryError):
            ConfigStore.instance().store(name=kind, group="scenes", node=default_values(kind))


def load(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """The composed root configuration, its node `hydra` included; struct flags are set.

    Raises HydraException or OmegaConfBaseException.
    """
    from hydra import version
    from hydra.core.utils import setup_globals
    from hydra.types import RunMode

    with _lock:
        setup_globals()
        register_search_path()
        versions = version.VersionBase.instance()
        version_before = versions.version_base
        version.setbase(_VERSION_BASE)
        try:
            loader = hydra_loader(_CONFIG_MODULE)
            # Hydra asks its global instance for the name of a job that has none.
            named = [*overrides, "hydra.job.name=simnfnd"]
            composed: DictConfig = loader.load_configuration(
                config_name, named, RunMode.RUN, from_shell=False
            )
            return composed
        finally:
            versions.version_base = version_before
