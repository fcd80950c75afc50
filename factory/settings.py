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

from .errors import FactoryError

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)

ClassName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}$")]
"""What the user may call a class of objects; see `labels`."""

T = TypeVar("T")


def build(kind: type[T] | Any, values: Mapping[str, Any], prefix: str = "") -> T:
    """Turn a plain mapping into the frozen settings object `kind`.

    Raises FactoryError with one line that names every offending key (with `prefix` before it).
    """
    try:
        result: T = TypeAdapter(kind).validate_python(dict(values))
        return result
    except ValidationError as error:
        raise FactoryError(_one_line(error, values, prefix)) from error


def _one_line(error: ValidationError, values: Mapping[str, Any], prefix: str) -> str:
    parts = []
    for item in error.errors():
        key = ".".join(_keys(item["loc"], values, absent=item["type"] == "missing"))
        name = ".".join(part for part in (prefix, key) if part) or "config"
        if item["type"] == "unexpected_keyword_argument":
            parts.append(f"{name}: unknown key{_nearest(key, values)}")
        elif item["type"] == "missing":
            parts.append(f"{name}: a value is required")
        else:
            message = item["msg"].removeprefix("Value error, ").rstrip(".")
            given = item.get("input")
            shown = f" (given: {given!r})" if isinstance(given, str | int | float | bool) else ""
            parts.append(f"{name}: {message}{shown}")
    return "; ".join(dict.fromkeys(parts))


def _nearest(key: str, values: Any) -> str:
    """`; did you mean ...?` with the key beside it that is most like it."""
    *parents, last = key.split(".")
    for step in parents:
        values = values.get(step, {}) if isinstance(values, Mapping) else {}
    beside = [str(one) for one in values if one != last] if isinstance(values, Mapping) else []
    close = difflib.get_close_matches(last, beside, n=1, cutoff=0.7)
    return f"; did you mean {'.'.join([*parents, *close])}?" if close else ""


def _keys(steps: tuple[int | str, ...], values: Any, *, absent: bool) -> list[str]:
    """The steps that are keys (or positions) of the given values.

    The others name the choice of a union or a validator.  absent: the last step is a missing key.
    """
    keys = []
    for step in steps:
        known = isinstance(values, Mapping) and step in values
        if isinstance(values, list | tuple) and isinstance(step, int):
            known = step < len(values)
        if known:
            values = values[step]
            keys.append(str(step))
    return [*keys, str(steps[-1])] if absent else keys
