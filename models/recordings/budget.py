"""How much a stranger's file may unpack to: one rule for every reader, asked before unpacking.

A file may unpack to `RATIO` times its size, a small one to `ALWAYS_BYTES`, and to no more than
`MOST_BYTES` at once.  Raw sonar pictures are black for the most part and pack 5 to 50 times.
A picture has at most `MOST_PIXELS`, whatever it is packed into.
"""

from __future__ import annotations

from ...factory.errors import FrameError

RATIO = 200
ALWAYS_BYTES = 1 << 28
MOST_BYTES = 1 << 31
MOST_PIXELS = 1 << 26


def most_streamed(size: int) -> int:
    """Bytes that a file of `size` bytes may give in all, read piece by piece."""
    return ALWAYS_BYTES + RATIO * size


def most_at_once(size: int) -> int:
    """Bytes that a file of `size` bytes may unpack to in memory."""
    return min(MOST_BYTES, most_streamed(size))


def ask_bytes(what: str, needed: int, most: int) -> None:
    """Raise FrameError unless `needed` bytes are at most `most`, of one of the above."""
    if needed > most:
        raise FrameError(
            f"{what}: unpacks to {needed:,} bytes or more, at most {most:,} are read ({RATIO} "
            f"times the file's size, {MOST_BYTES >> 30} GiB at once); if it is sound, save it "
            "uncompressed or in parts"
        )


def ask_pixels(what: str, width: float, height: float) -> None:
    """Raise FrameError for a picture of more than `MOST_PIXELS`."""
    if width * height > MOST_PIXELS:
        raise FrameError(f"{what}: {width:.0f} x {height:.0f} pixels are {too_large()}")


def too_large() -> str:
    """Words for a picture of more than `MOST_PIXELS`."""
    return f"too large; up to {MOST_PIXELS:,} (such as 8192 x 8192) can be read, cut it into parts"
