"""The parameters of a configuration as controls of a page: unit, range and one sentence each.

Everything is read from the settings classes themselves: types and limits from their annotations,
units from `parameter` or the ending of a name, sentences from the docstring of the class.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from ...factory.common.distribution import Distribution
from ...factory.simulation.noise.registry import blocks

if TYPE_CHECKING:
    from ...factory.simulation.config.root import FactoryConfig

Kind = Literal["number", "switch", "choice"]
_UNITS = {
    "db_per_m": "dB/m",
    "db_per_decade": "dB per decade",
    "m_s": "m/s",
    "deg": "degrees",
    "khz": "kHz",
    "db": "dB",
    "px": "pixels",
    "m": "m",
    "s": "s",
}
"""Units by the ending of a key; the longest ending that fits counts."""
_WRITTEN_UNITS = {"1": "", "deg": "degrees"}
_STEPS_OF_A_SLIDER = 200
_DECIBELS_BESIDE = 20.0
_LARGEST_COUNT = 10.0
_OPEN = 1e-9
"""How far the least value lies from a limit that is no value itself."""


@dataclass(frozen=True)
class Control:
    """One control of the page.

    key: dotted, as for `simnfnd make`.  group: the block that holds it.  kind: of the control.
    value: as a configuration file has it: a number, a distribution, true or false, a word, null.
    unit: "" where it has none.  low, high, step: of the slider.  lowest, highest: what the
    configuration accepts; None without a limit.  words: of kind choice.
    is_whole: whether it takes whole numbers alone.  can_be_drawn: whether it takes a distribution.
    can_be_null: whether it may be left unset.  sentence: what it is.
    """

    key: str
    group: str
    kind: Kind
    value: Any
    sentence: str
    unit: str = ""
    low: float = 0.0
    high: float = 1.0
    step: float = 0.01
    lowest: float | None = None
    highest: float | None = None
    words: tuple[str, ...] = ()
    is_whole: bool = False
    can_be_drawn: bool = False
    can_be_null: bool = False

    def plain(self) -> dict[str, Any]:
        """The control as plain data for JSON."""
        return asdict(self)


def parameters_of(config: FactoryConfig) -> list[Control]:
    """The parameters of the noise, the device and its image formation, group by group."""
    parameters: list[Control] = []
    for name, block in blocks(config.noise).items():
        parameters += _of_settings(f"noise.{name}", block)
    parameters += _of_settings("sonar", config.sonar)
    parameters += _of_settings("acoustics", config.acoustics)
    if config.acoustics.formation == "pointwise":
        parameters += _of_settings("resample", config.resample)
    return parameters


def _of_settings(group: str, settings: Any) -> Iterator[Control]:
    """Own parameters first, then those of the settings inside; text, lists and tables are none."""
    hints = get_type_hints(type(settings), include_extras=True)
    sentences = sentences_of(type(settings))
    nested = []
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value) and not isinstance(value, Distribution):
            nested.append((f"{group}.{item.name}", value))
            continue
        limits = _limits_of(hints[item.name])
        unit = str(item.metadata.get("unit") or unit_of(item.name))
        parameter = _parameter(group, item.name, value, limits, unit, sentences.get(item.name, ""))
        if parameter is not None:
            yield parameter
    for inner_group, inner_settings in nested:
        yield from _of_settings(inner_group, inner_settings)


class _Limits(NamedTuple):
    """What an annotation says of a value; types: of which it may be."""

    types: frozenset[type]
    words: tuple[str, ...]
    lowest: float
    highest: float


def _limits_of(hint: Any) -> _Limits:
    """What a type annotation allows: its types, the words of its Literals, and its limits.

    Looks through unions and Annotated; the narrowest of several limits counts.
    """
    types: set[type] = set()
    words: list[str] = []
    lowest = -math.inf
    highest = math.inf
    waiting = [hint]
    while waiting:
        part = waiting.pop()
        if get_origin(part) is Literal:
            words += [word for word in get_args(part) if isinstance(word, str)]
        elif get_origin(part) in (tuple, list, dict):
            types.add(tuple)
        elif get_args(part):
            waiting += get_args(part)
        elif isinstance(part, type):
            types.add(part)
        for limit in [part, *getattr(part, "metadata", ())]:
            lowest = max(lowest, _bound(limit, "ge"), _bound(limit, "gt") + _OPEN)
            highest = min(highest, -_bound(limit, "le", -1), -_bound(limit, "lt", -1) - _OPEN)
    return _Limits(frozenset(types), tuple(words), lowest, highest)


def _bound(limit: Any, name: str, sign: int = 1) -> float:
    """The number of a constraint such as `Ge(0)`, times `sign`; -inf where it is another."""
    value = getattr(limit, name, None)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return sign * float(value) if is_number else -math.inf  # type: ignore[arg-type]


def _parameter(
    group: str, name: str, value: Any, limits: _Limits, unit: str, sentence: str
) -> Control | None:
    """The control of a key: a choice, a switch or a slider; None where a slider makes no sense.

    value: the present one.  unit, sentence: what the page says of it.
    """
    key = f"{group}.{name}"
    if limits.words:
        if len(limits.words) == 1:
            return None
        return Control(key, group, "choice", value, sentence, words=limits.words)
    if bool in limits.types:
        return Control(key, group, "switch", value, sentence or "whether it acts")
    if tuple in limits.types or not limits.types & {int, float, Distribution}:
        return None

    lowest = limits.lowest
    highest = limits.highest
    plain = value
    numbers: tuple[float, ...] = () if value is None else (value,)
    if isinstance(value, Distribution):
        lowest = value.low
        highest = value.high
        plain = value.plain()
        numbers = _ends_of(value)
    is_whole = int in limits.types and float not in limits.types
    low, high = slider_ends(numbers, lowest, highest, unit)
    is_counted = is_whole or (unit == "1" and high > 1 and all(n == round(n) for n in numbers))
    step = 1.0 if is_counted else _step(high - low)
    if low < step and low == _rounded(lowest) > 0:
        # Else all values of the slider would have its last digits.
        low = step
    return Control(
        key,
        group,
        "number",
        plain,
        sentence,
        unit=_WRITTEN_UNITS.get(unit, unit),
        low=low,
        high=high,
        step=step,
        lowest=_if_finite(lowest),
        highest=_if_finite(highest),
        is_whole=is_whole,
        can_be_drawn=isinstance(value, Distribution),
        can_be_null=type(None) in limits.types,
    )


def _ends_of(distribution: Distribution) -> tuple[float, ...]:
    if distribution.kind != "normal":
        return distribution.values
    mean, deviation = distribution.values
    return mean - 2 * deviation, mean + 2 * deviation


def slider_ends(
    numbers: tuple[float, ...], lowest: float, highest: float, unit: str
) -> tuple[float, float]:
    """Ends of a slider around these numbers, inside the limits.

    Of decibels 20 beside them; of others from 0, or where they may be negative from the same
    distance below it, to three times the largest.
    """
    smallest = min(numbers, default=0.0)
    largest = max(numbers, default=0.0)
    if unit == "dB":
        low = smallest - _DECIBELS_BESIDE
        high = largest + _DECIBELS_BESIDE
    else:
        high = 3 * max(abs(smallest), abs(largest)) or _LARGEST_COUNT
        low = -high if lowest < 0 else 0.0
    return _rounded(max(low, lowest)), _rounded(min(high, highest))


def _rounded(value: float) -> float:
    """The value without the last digits, which arithmetic has left."""
    return float(f"{value:.9g}")


def _step(span: float) -> float:
    """1, 2 or 5 times a power of ten: a two-hundredth of the span, or somewhat less."""
    fine = span / _STEPS_OF_A_SLIDER
    power = 10.0 ** math.floor(math.log10(fine))
    factor = max(factor for factor in (1, 2, 5) if factor * power <= fine * (1 + 1e-9))
    return _rounded(factor * power)


def _if_finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def unit_of(name: str) -> str:
    """The unit that the name of a key ends with; "" without one."""
    for ending in sorted(_UNITS, key=len, reverse=True):
        if name == ending or name.endswith(f"_{ending}"):
            return _UNITS[ending]
    return ""


def sentences_of(settings: type) -> dict[str, str]:
    """What the docstring of a settings class says of each key, as in `name, other: Sentence`."""
    names = "|".join(item.name for item in fields(settings))
    docstring = " ".join(inspect.cleandoc(settings.__doc__ or "").split())
    parts = re.split(rf"(?:^|(?<=\s))((?:{names})(?:, (?:{names}))*): ", docstring)
    help_texts: dict[str, str] = {}
    for keys, text in zip(parts[1::2], parts[2::2], strict=True):
        sentence = re.split(r"(?<=\.)\s", text.strip(), maxsplit=1)[0]
        help_texts |= dict.fromkeys(keys.split(", "), sentence)
    return help_texts
