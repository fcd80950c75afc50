"""config.yaml of a dataset: what its owner calls it and which licence it has."""

from __future__ import annotations

from pathlib import Path

import yaml

from simnfnd.factory.dataset.format.manifest import CONFIG_NAME
from simnfnd.factory.errors import FactoryError


def dataset_settings(directory: Path) -> dict[str, object]:
    """The `dataset` block of config.yaml; empty when there is none.

    Raises FactoryError when the file cannot be read.
    """
    path = directory / CONFIG_NAME
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FactoryError(f"{path}: cannot be read ({reason}); restore or delete it") from error
    block = values.get("dataset") if isinstance(values, dict) else None
    return block if isinstance(block, dict) else {}
