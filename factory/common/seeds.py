"""Random streams that depend only on what is drawn, never on when or where.

The same root seed and the same names give the same numbers in any order of work, on any number of
workers, before and after an interruption.  `hash()` is salted per process and is never used.
"""

from __future__ import annotations

import hashlib

import numpy as np


def spawn_key(*names: str | int) -> tuple[int, ...]:
    """Four 32-bit words that stand for `names` (blake2b, so equal in every process and release)."""
    text = "\x1f".join(str(name) for name in names).encode()
    digest = hashlib.blake2b(text, digest_size=16).digest()
    return tuple(int(word) for word in np.frombuffer(digest, dtype="<u4"))


def stream(root_seed: int, *names: str | int) -> np.random.Generator:
    """A generator for the draw named by `names`, for example (stage, scene, frame, variant)."""
    # SeedSequence(root_seed, spawn_key=...) put together by hand, which takes a third of the time:
    # the seed in 32-bit words, the lowest first, at least the four of its pool.
    count = max(4, -(-root_seed.bit_length() // 32))
    words = [root_seed >> 32 * word & 0xFFFFFFFF for word in range(count)]
    sequence = np.random.SeedSequence(np.array([*words, *spawn_key(*names)], dtype=np.uint32))
    return np.random.Generator(np.random.PCG64(sequence))
