"""Pictures of 16-bit codes as byte strings that a general compressor makes little of, and back.

Compiled by numba, because an entry of the cache is read for every frame of every dataset; the tests
hold both directions against the same steps in numpy.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...compiled import compiled

Codes = npt.NDArray[np.uint16]


def pack(codes: Codes) -> bytes:
    """(H, W) codes as 2 H W bytes: second differences, folded to small numbers.

    Low and high bytes lie apart, in an order that no machine's own byte order changes.
    """
    planes = np.empty((2, codes.size), np.uint8)
    _fold(np.ascontiguousarray(codes), planes)
    return planes.tobytes()


def unpack(
    content: bytes, shape: tuple[int, int], table: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """(H, W) float32: `table` at each code that `pack` wrote.

    Raises ValueError when `content` is not as long as the shape says.
    """
    planes = np.frombuffer(content, np.uint8).reshape(2, shape[0] * shape[1])
    values = np.empty(shape, np.float32)
    _unfold(planes, table, values)
    return values


def rounded(
    values: npt.NDArray[np.float32], low: float, step: float, table: npt.NDArray[np.float32]
) -> tuple[Codes, npt.NDArray[np.float32]]:
    """(H, W) uint16 code of each value, and (H, W) float32 `table` at it.

    A code is 0 for nothing (no value above 0), else 1 + the logarithm of value / low in steps,
    rounded, at most 65,534.  values: (H, W) float32.  table: (65536,) float32.
    """
    codes, looked_up = np.empty(values.shape, np.uint16), np.empty(values.shape, np.float32)
    first, width = np.float32(math.log(low) - step), np.float32(step)
    levels = np.empty((min(_ROWS, len(values)), values.shape[1]), np.float32)
    for start in range(0, len(values), _ROWS):
        rows = slice(start, start + _ROWS)
        some = np.ascontiguousarray(values[rows])
        # By numpy, whose single precision is its own; the rest are steps that round everywhere
        # alike.
        level = np.maximum(some, _LEAST, out=levels[: len(some)])
        np.log(level, out=level)
        _round(some, level, first, width, table, codes[rows], looked_up[rows])
    return codes, looked_up


# Rows at a time that stay in the cache.
_ROWS = 32
_LEAST = np.float32(1e-38)


@compiled(
    "void(Array(float32, 2, 'C', readonly=True), float32[:, ::1], float32, float32,"
    "Array(float32, 1, 'C', readonly=True), uint16[:, ::1], float32[:, ::1])"
)
def _round(
    values: npt.NDArray[np.float32],
    levels: npt.NDArray[np.float32],
    first: np.float32,
    step: np.float32,
    table: npt.NDArray[np.float32],
    codes: Codes,
    looked_up: npt.NDArray[np.float32],
) -> None:
    height, width = values.shape
    least, most = np.float32(1), np.float32(65_534)
    for row in range(height):
        for column in range(width):
            level = np.rint((levels[row, column] - first) / step)
            level = min(max(level, least), most)
            # Whole numbers of 32 bits: several at a time.
            code = np.int32(level if values[row, column] > 0 else np.float32(0))
            codes[row, column] = np.uint16(code)
        for column in range(width):
            looked_up[row, column] = table[codes[row, column]]


@compiled("void(uint16[:, ::1], uint8[:, ::1])")
def _fold(codes: Codes, planes: npt.NDArray[np.uint8]) -> None:
    height, width = codes.shape
    for row in range(height):
        before = np.uint16(0)
        for column in range(width):
            above = codes[row - 1, column] if row else np.uint16(0)
            down = np.uint16(codes[row, column] - above)
            step = np.int16(np.uint16(down - before))
            before = down
            folded = np.uint16((step << 1) ^ (step >> 15))
            planes[0, row * width + column] = folded & 255
            planes[1, row * width + column] = folded >> 8


@compiled(
    "void(Array(uint8, 2, 'C', readonly=True), Array(float32, 1, 'C', readonly=True),"
    "float32[:, ::1])"
)
def _unfold(
    planes: npt.NDArray[np.uint8],
    table: npt.NDArray[np.float32],
    values: npt.NDArray[np.float32],
) -> None:
    height, width = values.shape
    above = np.zeros(width, np.uint16)
    for row in range(height):
        down = np.uint16(0)
        for column in range(width):
            at = row * width + column
            folded = np.uint16(planes[0, at] | np.uint16(planes[1, at]) << 8)
            step = np.uint16((folded >> 1) ^ np.uint16(-np.int16(folded & 1)))
            down = np.uint16(down + step)
            code = np.uint16(above[column] + down)
            above[column] = code
            values[row, column] = table[code]
