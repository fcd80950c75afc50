"""Journals of workers that share no folder with the run: they come by way of the URL."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from .publish import Publication

_EVERY_S = 2.0


class Distant:
    """Brings the journals of such workers here; false, and idle, where they are here anyway."""

    def __init__(self, publication: Publication | None) -> None:
        self._publication = publication if publication and publication.apart else None
        self._heard = 0.0

    def __bool__(self) -> bool:
        return self._publication is not None

    def hear(self, journals: Sequence[Path], *, at_once: bool = False) -> None:
        """Bring these journals up to date, unless that was done a moment ago."""
        if self._publication is None or not (at_once or time.monotonic() > self._heard + _EVERY_S):
            return
        for journal in journals:
            self._publication.hear(journal)
        self._heard = time.monotonic()

    def forget(self, journal: Path) -> None:
        """The attempt is over."""
        if self._publication is not None:
            self._publication.forget(journal)
