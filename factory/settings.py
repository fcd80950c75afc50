"""How every room declares its configuration: frozen dataclasses that validate themselves.

A room writes `@dataclass(frozen=True, config=STRICT)` with `pydantic.dataclasses.dataclass`, so an
unknown key, a wrong type or a value out of range is refused with the key's name, whether it came
from a YAML file, the command line or Python.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from simnfnd.factory.errors import FactoryError

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)

T = TypeVar("T")


def build(kind: type[T] | Any, values: Mapping[str, Any], prefix: str = "") -> T:
    """Turn a plain mapping into the frozen settings object `kind`.

    Raises FactoryError with one line that names every offending key (with `prefix` before it).
    """
    try:
        result: T = TypeAdapter(kind).validate_python(dict(values))
        return result
    except ValidationError as error:
        raise FactoryError(_one_line(error, prefix)) from error


def _one_line(error: ValidationError, prefix: str) -> str:
    parts = []
    for item in error.errors():
        # Tags of discriminated unions and validator names are steps of pydantic's own, not keys.
        key = ".".join(str(step) for step in item["loc"] if not _is_internal(step))
        name = ".".join(part for part in (prefix, key) if part) or "config"
        if item["type"] == "unexpected_keyword_argument":
            parts.append(f"{name}: unknown key")
        elif item["type"] == "missing":
            parts.append(f"{name}: a value is required")
        else:
            message = item["msg"].removeprefix("Value error, ").rstrip(".")
            given = item.get("input")
            shown = f" (given: {given!r})" if isinstance(given, str | int | float | bool) else ""
            parts.append(f"{name}: {message}{shown}")
    return "; ".join(dict.fromkeys(parts))


def _is_internal(step: int | str) -> bool:
    return isinstance(step, str) and (step.startswith("function-") or step in _UNION_TAGS)


# Filled by rooms whose settings are chosen by a `kind` key.
_UNION_TAGS: set[str] = set()


def union_tags(*tags: str) -> None:
    """Tell the error text which names are tags of a `kind` union and not keys of the config."""
    _UNION_TAGS.update(tags)
