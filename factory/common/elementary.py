"""Elementary functions for compiled loops, and a loop over numbers that several rooms share.

Written out, because a loop must run several numbers at a time, and because the bytes of a dataset
may not depend on the C library: atan of Abramowitz and Stegun (1964) 4.4.49, within 2e-8 before
rounding; cos by its series up to the twelfth power, within 1e-8.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .compiled import compiled

_F = np.float32
_ONE = _F(1)
_ZERO = _F(0)
_TINY = _F(1e-30)
_PI = _F(np.pi)
_HALF_PI = _F(np.pi / 2)
_A2 = _F(-0.3333314528)
_A4 = _F(0.1999355085)
_A6 = _F(-0.1420889944)
_A8 = _F(0.1065626393)
_A10 = _F(-0.07528964)
_A12 = _F(0.0429096138)
_A14 = _F(-0.0161657367)
_A16 = _F(0.0028662257)
_C = tuple(_F((-1) ** k / math.factorial(2 * k)) for k in range(7))
_L3 = _F(1 / 3)
_L5 = _F(1 / 5)
_L7 = _F(1 / 7)
_L9 = _F(1 / 9)
_LN2 = _F(np.log(2))
_ROOT2 = _F(np.sqrt(2))

_S = tuple(
    _F((-1) ** k * (2 * np.pi) ** j / math.factorial(j)) for k, j in enumerate(range(1, 12, 2))
)
_HALF = _F(0.5)
_ROUND = _F(12582912)  # adding and subtracting it rounds to whole numbers
_LOG2E = _F(1 / np.log(2))
_ROOT_HALF_BITS = np.int32(0x3F3504F3)  # of sqrt(1/2), the least mantissa of `log`
_E = tuple(_F(np.log(2) ** k / math.factorial(k)) for k in range(7))

FLOATS = "Array(float32, 1, 'C', readonly=True)"
_OUT = "float32[::1]"


@compiled()
def atan2(y: Any, x: Any) -> Any:
    """Angle of (x, y), float32, radians."""
    across = np.abs(y)
    along = np.abs(x)
    small = across if across < along else along
    large = along if across < along else across
    t = small / (large + _TINY)
    u = t * t
    series = _A8 + u * (_A10 + u * (_A12 + u * (_A14 + u * _A16)))
    angle = t * (_ONE + u * (_A2 + u * (_A4 + u * (_A6 + u * series))))
    angle = _HALF_PI - angle if across > along else angle
    angle = _PI - angle if x < _ZERO else angle
    return -angle if y < _ZERO else angle


@compiled()
def cos(angle: Any) -> Any:
    """Cosine of an angle within a quarter turn, float32."""
    u = angle * angle
    return _ONE + u * (_C[1] + u * (_C[2] + u * (_C[3] + u * (_C[4] + u * (_C[5] + u * _C[6])))))


@compiled()
def sine_of_turns(turns: Any) -> Any:
    """Sine of an angle in turns, float32, |turns| < 2^21, by its series, within 6e-8."""
    part = turns - ((turns + _ROUND) - _ROUND)
    size = abs(part)
    size = min(size, _HALF - size)
    t = size if part >= _F(0) else -size
    u = t * t
    return t * (_S[0] + u * (_S[1] + u * (_S[2] + u * (_S[3] + u * (_S[4] + u * _S[5])))))


@compiled()
def exponential(x: Any) -> Any:
    """Exponential, float32, -80 <= x <= 80, within 2e-7 of its size."""
    turns = x * _LOG2E
    whole = (turns + _ROUND) - _ROUND
    t = turns - whole
    series = _E[3] + t * (_E[4] + t * (_E[5] + t * _E[6]))
    mantissa = _ONE + t * (_E[1] + t * (_E[2] + t * series))
    bits = np.int32(np.int32(whole) + np.int32(127)) << np.int32(23)
    return mantissa * np.int32(bits).view(np.float32)


@compiled()
def log(value: Any) -> Any:
    """Natural logarithm of a positive, not subnormal number, float32.

    2 artanh((m - 1) / (m + 1)) with the mantissa m in [0.7, 1.4], by its series.
    """
    bits = _F(value).view(np.int32)
    exponent = np.int32((bits - _ROOT_HALF_BITS) >> np.int32(23))
    m = np.int32(bits - (exponent << np.int32(23))).view(np.float32)
    s = (m - _ONE) / (m + _ONE)
    u = s * s
    series = _L3 + u * (_L5 + u * (_L7 + u * _L9))
    return _F(exponent) * _LN2 + (s + s) * (_ONE + u * series)


@compiled()
def rotation_numbers(rotation: Any) -> Any:
    """The nine numbers of a (3, 3) rotation, row by row.

    A loop that gets them before it begins does several points at a time: the compiler then knows
    that nothing written in the loop changes them.
    """
    return (
        rotation[0, 0], rotation[0, 1], rotation[0, 2],
        rotation[1, 0], rotation[1, 1], rotation[1, 2],
        rotation[2, 0], rotation[2, 1], rotation[2, 2],
    )  # fmt: skip


@compiled()
def rotated(numbers: Any, x: Any, y: Any, z: Any) -> Any:
    """The three coordinates of a point after a rotation; numbers: of `rotation_numbers`."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = numbers
    return (
        xx * x + xy * y + xz * z,
        yx * x + yy * y + yz * z,
        zx * x + zy * y + zz * z,
    )


@compiled(f"void({FLOATS}, {_OUT})")
def half_normal(chance: Any, size: Any) -> None:
    """sqrt(2) erfinv(chance) of chances in [0, 1): |N(0, 1)| for uniform chances.

    erfinv in single precision after M. Giles, "Approximating the erfinv function", GPU Computing
    Gems 2 (2011): a polynomial of w = -log((1 - x)(1 + x)) below 5 and one of sqrt(w) above.
    """
    for at in range(len(chance)):
        x = chance[at]
        w = -log((_ONE - x) * (_ONE + x))
        w = w if w > _ZERO else _ZERO
        u = w - _F(2.5)
        v = np.sqrt(w) - _F(3)
        near = _F(3.43273939e-07) + u * _F(2.81022636e-08)
        near = _F(-4.39150654e-06) + u * (_F(-3.5233877e-06) + u * near)
        near = _F(-0.00125372503) + u * (_F(0.00021858087) + u * near)
        near = _F(0.246640727) + u * (_F(-0.00417768164) + u * near)
        near = _F(1.50140941) + u * near
        far = _F(0.000100950558) + v * _F(-0.000200214257)
        far = _F(-0.00367342844) + v * (_F(0.00134934322) + v * far)
        far = _F(-0.0076224613) + v * (_F(0.00573950773) + v * far)
        far = _F(1.00167406) + v * (_F(0.00943887047) + v * far)
        far = _F(2.83297682) + v * far
        size[at] = _ROOT2 * x * (near if w < _F(5) else far)


@compiled(f"void({FLOATS}, int64[::1], {_OUT})")
def ranked(values: Any, ranks: Any, out: Any) -> None:
    """The values of the given ranks (0 = smallest); `values` are not negative.

    The bits of such numbers are ordered as they are: count the upper halves, then, among the equal
    ones, the lower.
    """
    bits = values.view(np.uint32)
    # Neighbours are often equal: four tables in turn, so that no addition waits for the one before.
    turns = np.zeros((4, 1 << 16), np.int64)
    for at in range(len(bits)):
        turns[at & 3, bits[at] >> 16] += 1
    upper = turns[0] + turns[1] + turns[2] + turns[3]
    lower = np.zeros(1 << 16, np.int64)
    counted = -1
    for number in range(len(ranks)):
        left = ranks[number]
        half = 0
        while left >= upper[half]:
            left -= upper[half]
            half += 1
        if half != counted:
            counted = half
            lower[:] = 0
            for at in range(len(bits)):
                if bits[at] >> 16 == half:
                    lower[bits[at] & 0xFFFF] += 1
        rest = 0
        while left >= lower[rest]:
            left -= lower[rest]
            rest += 1
        value_bits = np.empty(1, np.uint32)
        value_bits[0] = (half << 16) | rest
        out[number] = value_bits.view(np.float32)[0]
