"""`data=renders data.experiment=any_sonar`: a device, a noise and a task of its own at every visit.

The renders are made once; device, formation, display, size and rasterisation of the picture are
drawn at each visit, and which artefacts are to be removed.  The target is the same picture without
them, under the same random streams.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...factory.config import FactoryConfig
from ...factory.errors import FactoryError, FrameError
from ...factory.frame import FrameRef
from ...factory.imaging.effect import ARTEFACTS
from ...factory.noise.draws import StreamNames, draw
from ...factory.pairs import ObservedFrame, observe_by
from ...factory.render.views import Views, open_views
from ...factory.seeds import stream
from ...factory.sonar.fan import rasterised
from ...factory.sonar.geometry import FanGeometry
from ...factory.sonar_randomization import draw as devices
from ..removal import DEFAULT, vector
from .pairs import Image, Sample, weakened

_ATTEMPTS = 40
_LEAST_ECHOES = 0.02
"""Part of the bins that must hold surface: a picture of nothing teaches nothing."""
_BLACK = 0.02
"""Shadow counts as such where the target is darker; under haze there is none to see."""


class DeviceSource:
    """Pairs of drawn devices; a `simnfnd.models.data.pairs.Source`."""

    def __init__(
        self,
        config: FactoryConfig,
        frames: tuple[FrameRef, ...],
        *,
        patch: int,
        weaker: float,
        choices: float,
        seed: int,
    ) -> None:
        """config: with `devices`.  frames: whose renders are at hand.  patch: least side, pixels.

        weaker: part of the visits whose noise is blended towards the target.  choices: part of them
        that ask for other artefacts than the usual ones.
        """
        if config.devices is None:
            raise FactoryError("data.experiment: has no `devices` to draw; use any_sonar")
        self.config, self.frames, self.patch = replace(config, seed=seed), frames, patch
        self.weaker, self.choices, self.seed = weaker, choices, seed
        self._views: Views | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_views": None}

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        names = (index, "validation" if visit is None else visit)
        for attempt in range(_ATTEMPTS):
            # A frame that shows nothing to this device gives way to the next one.
            ref = self.frames[(index + attempt // 4) % len(self.frames)]
            try:
                found = self._sample(ref, *names, attempt)
            except FrameError:
                continue
            if found is not None:
                return found
        raise FactoryError(
            f"data=renders: no device sees enough of {self.frames[index].name} and of the frames "
            "after it; make renders of other places"
        )

    def _sample(self, ref: FrameRef, *names: int | str) -> Sample | None:
        assert self.config.devices is not None
        if self._views is None:
            self._views = open_views(self.config)
        device = devices.draw(self.config.devices, self.seed, ref.name, *names)
        view = self._views.view(ref)
        observed, config = observe_by(
            device, view.frame(ref), view.rendered(), self.config, any_size=True
        )
        if observed.scene.filled.mean() < _LEAST_ECHOES or min(config.sonar.shape()) < self.patch:
            return None
        draws = draw(config.noise, self.seed, StreamNames.single(ref.name, *names))
        removed = self.removed(*names)
        # Points are thinned by a variant's stream: any number that no other picture has.
        variant = int(stream(self.seed, "variant", *names).integers(2**31))
        sample = observed.scene.sample(variant, draws.effects, config)
        noisy, clean = (
            rasterised(grey, observed.window, config.sonar, noisy=noisy)
            for grey, noisy in (
                (sample.noisy(draws.names), True),
                (sample.without(removed), False),
            )
        )
        strength = np.float32(weakened(self.weaker, self.seed, *names))
        return Sample(
            clean + strength * (noisy - clean),
            clean,
            _shadow(observed, clean),
            FanGeometry.from_sonar(config.sonar, *_limits(observed)),
            vector(removed),
        )

    def removed(self, *names: int | str) -> tuple[str, ...]:
        """The artefacts that the picture of this visit is to be freed of: usually `DEFAULT`."""
        rng = stream(self.seed, "remove", *names)
        if rng.random() >= self.choices:
            return DEFAULT
        chosen = tuple(name for name in ARTEFACTS if rng.random() < 0.5)
        return chosen or ("speckle",)


def _shadow(observed: ObservedFrame, clean: Image) -> Image:
    return (observed.shadow & (clean <= _BLACK)).astype(np.float32)


def _limits(observed: ObservedFrame) -> tuple[float, float, float, float]:
    window = observed.window
    return (
        window.range_min_m,
        window.range_max_m,
        window.azimuth_min_rad,
        window.azimuth_max_rad,
    )
