"""How the chunks of an image stack are stored: at most one compression, then Fletcher-32."""

from __future__ import annotations

from dataclasses import dataclass

import h5py
import numpy as np

from ...errors import FactoryError
from .schema import SCHEMA

_DEFLATE, _LZF, _ZSTD, _FLETCHER32 = 1, 32000, 32015, 3
_CODECS = {_DEFLATE: "gzip", _LZF: "lzf", _ZSTD: "zstd"}
# Of the sums of a piece of so many words.
_WEIGHTS = np.arange(1 << 16, 0, -1, dtype=np.float64)
# HDF5 notes the filters that a chunk was stored without by their place in the chain.
_CODEC_LEFT_OUT = 1


@dataclass(frozen=True)
class Chain:
    """codec: gzip, lzf, zstd or none.  ending: bytes of the Fletcher-32 checksum, 4 or 0."""

    codec: str
    ending: int

    def may_be(self, mask: int, size: int, full: int) -> bool:
        """Whether a chunk of that filter mask and size may hold a picture of `full` bytes.

        No filter may be left out, but for LZF, which has no answer to what it cannot make smaller.
        """
        if mask == _CODEC_LEFT_OUT and self.codec == "lzf":
            return size == full + self.ending
        if self.codec == "none":
            return mask == 0 and size == full + self.ending
        # All of them let what cannot be made smaller grow by far less than that.
        return mask == 0 and self.ending < size <= full + full // 16 + 4096


def chain_of(stack: h5py.Dataset) -> Chain:
    """The filters of an image stack.

    Raises FactoryError for any that the schema has not: it would be a library that HDF5 loads from
    wherever HDF5_PLUGIN_PATH points, or let a chunk grow without bound.
    """
    plist = stack.id.get_create_plist()
    codes = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
    ending = 4 if codes[-1:] == [_FLETCHER32] else 0
    codecs = codes[: len(codes) - bool(ending)]
    if len(codecs) > 1 or not set(codecs) <= set(_CODECS):
        raise FactoryError(f"{stack.name} uses filters {codes}, which are not of {SCHEMA}")
    if _ZSTD in codes and not h5py.h5z.filter_avail(_ZSTD):
        try:
            import hdf5plugin  # noqa: F401  (registers its filters; 186 MB, so only when needed)
        except ImportError as error:
            raise FactoryError(
                "compressed with zstd, which needs the hdf5plugin package: "
                "pip install 'simnfnd[zstd]'"
            ) from error
    if not all(h5py.h5z.filter_avail(code) for code in codes):
        raise FactoryError(f"{stack.name} uses filters {codes}, which this h5py lacks; renew h5py")
    return Chain(_CODECS[codecs[0]] if codecs else "none", ending)


def fletcher32(content: bytes) -> int:
    """HDF5's variant of Fletcher's checksum, which ends every chunk.

    Of big-endian 16-bit words w_1 .. w_n, an odd last byte being the upper half of one: the sums of
    w_i and of (n + 1 - i) w_i, each modulo 65535 where 0 stands for itself alone (H5checksum.c).
    """
    words = np.frombuffer(content + b"\0" * (len(content) % 2), ">u2").astype(np.float64)
    low = high = 0
    for start in range(0, len(words), len(_WEIGHTS)):
        piece = words[start : start + len(_WEIGHTS)]
        # Whole numbers below 2**53, so exact in any order.
        high += low * len(piece) + int((piece * _WEIGHTS[-len(piece) :]).sum())
        low += int(piece.sum())
    return _folded(high) << 16 | _folded(low)


def _folded(total: int) -> int:
    return (total - 1) % 65535 + 1 if total else 0
