"""The configuration that a dataset was made with, as its folder states it."""

from __future__ import annotations

from pathlib import Path

from ...common.errors import FactoryError
from ...common.small_files import load_yaml, one_line
from ...dataset.manifest import CONFIG_NAME
from .root import FactoryConfig, from_mapping

# A dataset may be untrusted, so it does not choose where renders are written or which
# cluster is connected to.
_OF_THIS_MACHINE = ("scheduler", "cache", "shard", "debug")


def stored_config(directory: Path, current: FactoryConfig) -> FactoryConfig:
    """What config.yaml says of the samples; scheduler and cache are those of `current`.

    Nothing that the file says is executed.  Raises FactoryError where it cannot be read.
    """
    path = directory / CONFIG_NAME
    try:
        values = load_yaml(path)
        kept_sections = {name: getattr(current, name) for name in _OF_THIS_MACHINE}
        return from_mapping({**values, **kept_sections})
    except (OSError, ValueError, TypeError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); restore it to make the same pairs"
        ) from error
    except FactoryError as error:
        raise FactoryError(f"{path}: {error}") from error
