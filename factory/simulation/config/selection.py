"""Which frames of a recording a dataset is made of, and which of them test."""

from __future__ import annotations

import fnmatch
import hashlib
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

from ...common.errors import FactoryError
from ...dataset.frame_ref import FrameRef
from .root import FactoryConfig

_Scene = tuple[str, str]


def choose_frames(refs: tuple[FrameRef, ...], config: FactoryConfig) -> tuple[FrameRef, ...]:
    """The frames that stride, limit, total and `only` leave, in order.

    Raises FactoryError when none is left or a name in `frames.only` is unknown.
    """
    settings = config.frames
    by_scene: dict[_Scene, list[FrameRef]] = {}
    for ref in refs:
        by_scene.setdefault((ref.location, ref.scene), []).append(ref)
    thinned = [refs[:: settings.stride][: settings.limit] for refs in by_scene.values()]
    chosen = _spread(thinned, settings.total)
    if settings.only is not None:
        wanted = {unicodedata.normalize("NFC", name): name for name in settings.only}
        by_name = {unicodedata.normalize("NFC", ref.name): ref for ref in refs}
        unknown = sorted(wanted.keys() - by_name.keys())
        if unknown:
            raise FactoryError(f"frames.only: no frame named {wanted[unknown[0]]}")
        chosen = [ref for name, ref in by_name.items() if name in wanted]
    if not chosen:
        raise FactoryError(
            "frames: no frame is left; check frames.stride, frames.limit, frames.only"
        )
    return tuple(chosen)


def split_frames(
    frames: tuple[FrameRef, ...], config: FactoryConfig
) -> dict[str, tuple[FrameRef, ...]]:
    """Train and test frames; a scene is in one of them, never in both."""
    scenes = _scenes(frames)
    patterns = config.split.test
    if patterns:
        testing = [
            scene for scene in scenes if any(_matches(scene, pattern) for pattern in patterns)
        ]
    else:
        testing = _by_fraction(scenes, config.split.test_fraction)
    return {
        "train": tuple(ref for ref in frames if (ref.location, ref.scene) not in testing),
        "test": tuple(ref for ref in frames if (ref.location, ref.scene) in testing),
    }


class SplitWarning(str):
    """A warning about train and test frames, for which not all readers of a dataset care."""

    __slots__ = ()


def split_warnings(
    splits: Mapping[str, Sequence[FrameRef]], config: FactoryConfig
) -> tuple[SplitWarning, ...]:
    """One line each: patterns of split.test that match nothing, and a split that stays empty.

    A split that is empty because it was asked for (no limit above 0, `frames.only`) is none.
    """
    settings = config.split
    limits = config.dataset.limits
    if config.frames.only is not None:
        return ()
    scenes = _scenes([ref for refs in splits.values() for ref in refs])
    said = []
    lost = [p for p in settings.test if not any(_matches(scene, p) for scene in scenes)]
    if lost:
        said.append(f"split.test: {', '.join(lost)}: no scene of that name here")
    wanted = bool(settings.test) or settings.test_fraction > 0
    for split in ("train", "test"):
        if not splits[split] and limits.get(split) != 0 and (wanted or split == "train"):
            fraction = "" if settings.test_fraction == 0.25 else " split.test_fraction=0.25"
            said.append(
                f"the {split} split is empty; split.test=[]{fraction} would test on a quarter of "
                f"the {len(scenes)} scenes"
                if len(scenes) > 1
                else f"the {split} split is empty, for there is one scene, {scenes[0][1]}; bring "
                "another, or train and evaluate on the one split (evaluate split=train)"
            )
    return tuple(map(SplitWarning, said))


def _scenes(frames: Iterable[FrameRef]) -> list[_Scene]:
    return sorted({(ref.location, ref.scene) for ref in frames})


def _matches(scene: _Scene, pattern: str) -> bool:
    """Whether a pattern is a scene's name, with or without its location, or matches it.

    Letters with accents may be composed or not, as file systems differ.
    """
    wanted = unicodedata.normalize("NFC", pattern)
    names = [unicodedata.normalize("NFC", name) for name in (scene[1], "/".join(scene))]
    return wanted in names or any(fnmatch.fnmatch(name, wanted) for name in names)


def _by_fraction(scenes: Sequence[_Scene], fraction: float) -> list[_Scene]:
    # By a hash of the name: a scene that is added later moves few others, and no order matters.
    ranked = sorted(scenes, key=lambda scene: hashlib.blake2b("/".join(scene).encode()).digest())
    count = round(fraction * len(scenes))
    if fraction > 0 and len(scenes) > 1:
        count = max(count, 1)
    return ranked[:count]


def _spread(by_scene: Sequence[Sequence[FrameRef]], total: int | None) -> list[FrameRef]:
    """Choose at most `total` frames, equally many of each scene and evenly spread in it.

    A larger total only adds to a smaller one.
    """
    refs = [ref for scene in by_scene for ref in scene]
    if total is None:
        return refs
    places = [
        (turn, scene)
        for scene, own in zip(_spread_order(len(by_scene)), by_scene, strict=True)
        for turn in _spread_order(len(own))
    ]
    order = sorted(range(len(refs)), key=places.__getitem__)
    return [refs[place] for place in sorted(order[:total])]


def _spread_order(count: int) -> list[int]:
    """The turn of each of `count` places, so that those taken first lie apart.

    By the reversed bits of the place: van der Corput's sequence.
    """
    bits = max(1, (count - 1).bit_length())
    order = sorted(range(count), key=lambda place: f"{place:0{bits}b}"[::-1])
    turns = [0] * count
    for turn, place in enumerate(order):
        turns[place] = turn
    return turns


def frames_digest(frames: tuple[FrameRef, ...]) -> str:
    """Hash of the names of the frames: a download that has grown makes another dataset."""
    names = "\n".join(ref.name for ref in frames)
    return hashlib.blake2b(names.encode(), digest_size=8).hexdigest()
