"""The checksum of HDF5's own tables: Bob Jenkins' lookup3, which no library gives out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...compiled import compiled

_WORD = 0xFFFFFFFF


def lookup3(content: bytes) -> int:
    """`H5_checksum_lookup3` of some bytes, of which there must be one at least."""
    padded = np.frombuffer(content + b"\0" * (-len(content) % 12), "<u4")
    return int(_lookup3(padded, len(content)))


@compiled("int64(int64, int64)")
def _turned(word: int, bits: int) -> int:
    return ((word << bits) | (word >> (32 - bits))) & _WORD


@compiled("int64(Array(uint32, 1, 'C', readonly=True), int64)")
def _lookup3(words: npt.NDArray[np.uint32], length: int) -> int:
    a = b = c = (0xDEADBEEF + length) & _WORD
    last = len(words) - 3
    for k in range(0, last, 3):
        a = (a + words[k]) & _WORD
        b = (b + words[k + 1]) & _WORD
        c = (c + words[k + 2]) & _WORD
        a, c = (a - c & _WORD) ^ _turned(c, 4), c + b & _WORD
        b, a = (b - a & _WORD) ^ _turned(a, 6), a + c & _WORD
        c, b = (c - b & _WORD) ^ _turned(b, 8), b + a & _WORD
        a, c = (a - c & _WORD) ^ _turned(c, 16), c + b & _WORD
        b, a = (b - a & _WORD) ^ _turned(a, 19), a + c & _WORD
        c, b = (c - b & _WORD) ^ _turned(b, 4), b + a & _WORD
    a = (a + words[last]) & _WORD
    b = (b + words[last + 1]) & _WORD
    c = (c + words[last + 2]) & _WORD
    c = (c ^ b) - _turned(b, 14) & _WORD
    a = (a ^ c) - _turned(c, 11) & _WORD
    b = (b ^ a) - _turned(a, 25) & _WORD
    c = (c ^ b) - _turned(b, 16) & _WORD
    a = (a ^ c) - _turned(c, 4) & _WORD
    b = (b ^ a) - _turned(a, 14) & _WORD
    found: int = (c ^ b) - _turned(b, 24) & _WORD
    return found
