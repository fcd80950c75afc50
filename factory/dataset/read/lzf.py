"""How much comes out of LZF data, without unpacking it: h5py's filter takes all memory it needs."""

from __future__ import annotations

# Three bytes stand for 264 at most.
LZF_GROWTH = 88


def lzf_length(content: bytes, most: int) -> int:
    """Bytes that LZF data stand for; stops beyond `most`.  Raises ValueError when they end early.

    A control byte c below 32 is followed by c + 1 bytes to copy.  Any other repeats c // 32 + 2
    bytes from before, or with c // 32 = 7 as many more as the next byte says; a byte of the offset
    follows (liblzf, lzf_d.c).
    """
    at = length = 0
    end = len(content)
    while at < end and length <= most:
        control = content[at]
        if control < 32:
            at += control + 2
            length += control + 1
            continue
        if control >= 224:
            at += 1
            if at >= end:
                break
            length += content[at]
        length += (control >> 5) + 2
        at += 2
    if at > end and length <= most:
        raise ValueError("its LZF data end early")
    return length
