"""How every room declares its configuration: frozen dataclasses that validate themselves.

A room writes `@dataclass(frozen=True, config=STRICT)` with `pydantic.dataclasses.dataclass`, so an
unknown key, a wrong type or a value out of range is refused with the key's name, whether it came
from a YAML file, the command line or Python.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from .errors import MOST_LISTED, FactoryError

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)

ClassName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}$")]
"""What the user may call a class of objects; see `meaning`."""

T = TypeVar("T")


def build(kind: type[T] | Any, values: Mapping[str, Any], prefix: str = "") -> T:
    """Turn a plain mapping into the frozen settings object `kind`.

    Raises FactoryError with one line that names every offending key (with `prefix` before it).
    """
    try:
        result: T = TypeAdapter(kind).validate_python(dict(values))
        return result
    except ValidationError as error:
        raise FactoryError(_one_line(error, kind, values, prefix)) from error


def _one_line(error: ValidationError, kind: Any, values: Mapping[str, Any], prefix: str) -> str:
    """All faults of a configuration in one line, each with its key; for a typo the nearest key."""
    parts = []
    for item in error.errors():
        keys, beside = _place(item["loc"], values)
        if item["type"] == "missing":
            keys.append(str(item["loc"][-1]))
        name = ".".join([*filter(None, [prefix]), *keys]) or "config"
        if item["type"] == "unexpected_keyword_argument":
            others = [str(field) for field in beside if str(field) != keys[-1]]
            near = difflib.get_close_matches(keys[-1], others, n=1, cutoff=0.7)
            hint = f"; did you mean {'.'.join([*keys[:-1], *near])}?" if near else ""
            parts.append(f"{name}: unknown key{hint}")
        elif item["type"] == "missing":
            parts.append(f"{name}: a value is required")
        elif item["type"] == "dataclass_type":
            inner = ", ".join(f"{name}.{key}" for key in _keys_of(kind, keys)[:MOST_LISTED])
            parts.append(f"{name}: holds other keys and no value of its own; set one of {inner}")
        else:
            message = item["msg"].removeprefix("Value error, ").rstrip(".")
            value = item.get("input")
            shown = f" (given: {value!r})" if isinstance(value, str | int | float | bool) else ""
            # What contradicts each other names its keys itself.
            parts.append(f"{name}: {message}{shown}" if item["loc"] else message)
    return "; ".join(dict.fromkeys(parts))


def _keys_of(kind: Any, keys: list[str]) -> list[str]:
    """The keys of the settings class at this place below `kind`, or where to find them."""
    for key in keys:
        settings = getattr(kind, "__pydantic_fields__", {})
        kind = settings[key].annotation if key in settings else None
    return list(getattr(kind, "__pydantic_fields__", {})) or ["its keys (see `--cfg job`)"]


def _place(steps: tuple[int | str, ...], values: Any) -> tuple[list[str], Any]:
    """The steps that are keys (or positions) of the given values, and what lies beside the last.

    The others name the choice of a union or a validator.
    """
    keys = []
    beside = values
    for step in steps:
        listed = isinstance(values, list | tuple) and isinstance(step, int) and step < len(values)
        if listed or (isinstance(values, Mapping) and step in values):
            beside = values
            values = values[step]
            keys.append(str(step))
    return keys, beside
