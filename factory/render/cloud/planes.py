"""Pictures of 16-bit codes as byte strings that a general compressor makes little of, and back.

Compiled by numba, because an entry of the cache is read for every frame of every dataset; the tests
hold both directions against the same steps in numpy.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simnfnd.factory.compiled import compiled

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
