"""A time-varying gain that does not fit the water: pictures too bright near by or far away."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...settings import STRICT
from ..effect import Effect, EffectSettings, parameter


@dataclass(frozen=True, config=STRICT)
class TvgErrorSettings(EffectSettings):
    """Keys of `noise.tvg_error`; the gain is right in the middle of the range window.

    db_per_decade: too much (or, negative, too little) gain for each tenfold range, dB.
    db_per_m: the same for each metre, dB/m.
    """

    db_per_decade: AnyNumber = parameter(0, "dB")
    db_per_m: AnyNumber = parameter(0, "dB/m")


def tvg_error(
    field: Floats, ping: Ping, rng: np.random.Generator, *, db_per_decade: float, db_per_m: float
) -> Floats:
    """The field under the wrong gain."""
    error_db = _error_db(ping, db_per_decade, db_per_m)
    field *= (10 ** (error_db / 20)).astype(np.float32)[:, None]
    return field


def expect_tvg_error(
    expected: Expected,
    ping: Ping,
    rng: np.random.Generator,
    *,
    db_per_decade: float,
    db_per_m: float,
) -> None:
    """The intensities under the wrong gain."""
    expected.scale(10 ** (_error_db(ping, db_per_decade, db_per_m) / 10)[:, None])


def _error_db(ping: Ping, db_per_decade: float, db_per_m: float) -> npt.NDArray[np.float64]:
    """(range_bins,) dB."""
    range_m = np.maximum(ping.range_m.astype(np.float64), ping.bin_m)
    middle_m = (ping.window.range_min_m + ping.window.range_max_m) / 2
    return np.asarray(
        db_per_decade * np.log10(range_m / middle_m) + db_per_m * (range_m - middle_m)
    )


TVG_ERROR = Effect(
    TvgErrorSettings,
    tvg_error,
    "picture",
    systematic=True,
    expected=expect_tvg_error,
    artefact="gains",
)
