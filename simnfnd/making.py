"""Pairs and datasets from Python: `make_pair` and `make_dataset`."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy.typing as npt

if TYPE_CHECKING:
    from .factory.common.progress import RunProgress
    from .factory.dataset.manifest import Failure
    from .factory.dataset.schema import Pair
    from .factory.simulation.config.root import FactoryConfig
    from .factory.simulation.imaging.effect import Effect
    from .factory.simulation.render.base import Renderer, RenderSettings

Words = str | Sequence[str]
"""Words of `simnfnd make`: several, or one text as a shell takes it."""


@dataclass(frozen=True)
class DatasetResult:
    """What `make_dataset` made.

    path: the dataset's folder, or its URL.  pairs: that it holds now, earlier runs included.
    failures: frames without a pair, each with `ref.name`, `kind` and `reason`.
    notes: what the command would have printed, warnings included.
    """

    path: str
    pairs: int
    failures: tuple[Failure, ...]
    notes: tuple[str, ...]


def make_dataset(
    *overrides: str,
    out: str | Path | None = None,
    progress: Callable[[RunProgress], None] | None = None,
) -> DatasetResult:
    """Make a dataset, or finish one that was begun, as `simnfnd make OVERRIDES` does.

    overrides: words of the command, for example "experiment=simnfnd", "frames.limit=10" and
        "--config-dir=presets".
    out: folder or URL of the dataset; the same as "dataset.dir=...".
    progress: called several times a second with a `RunProgress`.

    Prints nothing.  Worker processes import no `__main__`, so that a script needs no guard.
    Raises FactoryError for what the command ends with exit code 2 for; KeyboardInterrupt at Ctrl-C,
    and calling again goes on where it stopped.
    """
    from .factory.common.progress import RunReporter
    from .factory.common.workers import template
    from .factory.dataset.storage import shown
    from .factory.production.cli.generate import run
    from .factory.simulation.config.compose import compose_config

    config = compose_config(overrides)
    if out is not None:
        config = replace(config, dataset=replace(config.dataset, dir=str(out)))
    notes: list[str] = []
    reporter = RunReporter(
        fact=notes.append,
        warning=notes.append,
        stage=lambda _: None,
        progress=progress or (lambda _: None),
    )
    had_template = template.runs()
    try:
        report, directory = run(config, overrides, reporter)
    finally:
        if not had_template:
            template.kill()
    # Warnings of the plan come again at the end of a run.
    warnings = tuple(dict.fromkeys(notes))
    return DatasetResult(str(shown(directory)), report.samples, report.failures, warnings)


def make_pair(
    rgb: npt.ArrayLike,
    depth_m: npt.ArrayLike,
    *,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    config: Words = ("experiment=simnfnd", "render=analytic"),
    effects: Sequence[Effect] = (),
    seed: int | None = None,
    variant: int = 0,
    name: str = "frame",
    scene: str = "",
) -> Pair:
    """One (noisy, clean) pair of sonar images from an RGBD frame.

    rgb: (H, W, 3) integers 0..255, in the order red, green, blue.
    depth_m: (H, W) or (H, W, 1) distance along the optical axis in metres, floating-point; masked,
        0, negative, infinite and NaN mean that nothing was measured.
    fx, fy, cx, cy: focal lengths and principal point of this very image size, in pixels.
    config: words of `simnfnd make`, for example ("experiment=physical", "sonar=didson_hf");
        those of scenes, frames, scheduler and cache change nothing here.
    effects: of noise, of your own (`simnfnd.extensions`), with the defaults of their parameters;
        `config` may set them, for example "noise.mine.level=0.2".
    seed: the same as "seed=..." among `config`.
    variant: other numbers thin the echoes and draw the noise anew.
    name, scene: of the frame; with seed and variant they decide what is drawn.

    Returns a `Pair`: noisy and clean (H', W') uint8 in 0..255 (float32 in 0..1 with
    "dataset.dtype=float32"), shadow (H', W') bool, layers, and record, with every drawn parameter.
    `denoise` takes the pair as it is.
    Raises ValueError for arrays of another shape, type or unit, FrameError when the frame has no
    usable depth or the sonar would see nothing of it, and FactoryError for wrong words and modules
    that are not installed.
    """
    from .factory.common.extras import require
    from .factory.dataset.frame_ref import FrameRef
    from .factory.simulation.config.needs import needs_of
    from .factory.simulation.config.renderer_choice import renderer_of
    from .factory.simulation.frames.frame import Intrinsics
    from .factory.simulation.frames.memory_frame import frame_from_arrays
    from .factory.simulation.labels.camera_layers import FrameCamera
    from .factory.simulation.noise.registry import register_effect
    from .factory.simulation.pairs.pair_maker import PairMaker
    from .factory.simulation.pairs.views import Views
    from .factory.simulation.render.view import view_of

    words = shlex.split(config) if isinstance(config, str) else [*config]
    for effect in effects:
        register_effect(effect)
        words.insert(0, f"noise.{effect.name}.enabled=true")
    if seed is not None:
        words.append(f"seed={seed}")
    settings = _config(tuple(words), tuple(effects))
    require(needs_of(settings))
    ref = FrameRef("", scene, name)
    frame = frame_from_arrays(ref, rgb, depth_m, Intrinsics(fx, fy, cx, cy))
    mount = settings.sonar.mount
    rendered = _renderer(renderer_of(settings).settings).render(frame, mount)
    views = Views({ref: view_of(frame, rendered, mount)})
    maker = PairMaker(settings, views, FrameCamera(frame, settings.dataset.layers))
    (pair,) = maker.pairs(ref, (variant,))
    return pair


@lru_cache(maxsize=8)
def _config(words: tuple[str, ...], effects: tuple[Effect, ...]) -> FactoryConfig:
    """The configuration of keyword arguments.

    effects: those registered now; another one may have had the same name.
    """
    from .factory.simulation.config.compose import compose_config

    # The frame is at hand, so where recordings are does not matter.
    return compose_config(words, {"kind": "csv_list", "file": ".", "intrinsics": [1, 1, 0, 0]})


@lru_cache(maxsize=1)
def _renderer(settings: RenderSettings) -> Renderer:
    from .factory.simulation.render import open_renderer

    return open_renderer(settings)
