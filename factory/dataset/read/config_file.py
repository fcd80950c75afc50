"""config.yaml of a dataset: what its owner calls it and which licence it has."""

from __future__ import annotations

from pathlib import Path

from ...errors import FactoryError
from ...small_files import load_yaml, one_line
from ..format.manifest import CONFIG_NAME
from ..format.schema import DATASET_NAME


def dataset_settings(directory: Path) -> dict[str, object]:
    """The `dataset` block of config.yaml; empty when there is none.

    Raises FactoryError when the file cannot be read, or when name or licence are not what the
    settings allow: both go into the cards of exports.
    """
    path = directory / CONFIG_NAME
    try:
        values = load_yaml(path)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); restore or delete it"
        ) from error
    block = values.get("dataset") if isinstance(values, dict) else None
    if not isinstance(block, dict):
        return {}
    name, licence = block.get("name"), block.get("licence")
    if name is not None and not (isinstance(name, str) and DATASET_NAME.fullmatch(name)):
        raise FactoryError(
            f"{path}: dataset.name {str(name)[:40]!r} must be letters, digits, dot, dash and "
            "underscore"
        )
    if licence is not None and not isinstance(licence, str):
        raise FactoryError(f"{path}: dataset.licence {str(licence)[:40]!r} must be text")
    return block
