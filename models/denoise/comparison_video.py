"""The video of `--compare FILE.mp4`: noisy and denoised side by side, for any player."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...factory.common.array_types import Array
from ..recordings.plain_video import SUFFIX, PlainVideo, plain_video
from .writers import side_by_side

__all__ = ["SUFFIX", "ComparisonVideo", "comparison_video"]


@contextmanager
def comparison_video(path: Path | None) -> Iterator[ComparisonVideo | None]:
    """A video that is at `path` when the block ends without an error; None for no path.

    Raises FactoryError when it cannot be written.
    """
    if path is None:
        yield None
        return
    with plain_video(path) as video:
        yield ComparisonVideo(video)


class ComparisonVideo:
    """A video that is being written; the first image decides its size."""

    def __init__(self, video: PlainVideo) -> None:
        self._video = video

    def add(self, noisy: Array, denoised: Array, time_s: float | None = None) -> None:
        """The next image, (H, W) or (H, W, C); uint8, uint16 or float in 0..1.

        time_s: when it was taken; None: unknown.
        """
        self._video.add(side_by_side({"noisy": noisy, "denoised": denoised}), time_s)
