"""Which frames of a recording a dataset is made of, and which of them test."""

from __future__ import annotations

import fnmatch
import hashlib

from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import FrameRef


def choose_frames(found: tuple[FrameRef, ...], config: FactoryConfig) -> tuple[FrameRef, ...]:
    """The frames that stride, limit and `only` leave, in order.

    Raises FactoryError when none is left or a name in `frames.only` is unknown.
    """
    settings = config.frames
    by_scene: dict[tuple[str, str], list[FrameRef]] = {}
    for ref in found:
        by_scene.setdefault((ref.location, ref.scene), []).append(ref)
    chosen = [
        ref for refs in by_scene.values() for ref in refs[:: settings.stride][: settings.limit]
    ]
    if settings.only is not None:
        unknown = set(settings.only) - {ref.name for ref in found}
        if unknown:
            raise FactoryError(f"frames.only: no frame named {sorted(unknown)[0]}")
        chosen = [ref for ref in found if ref.name in settings.only]
    if not chosen:
        raise FactoryError(
            "frames: no frame is left; check frames.stride, frames.limit, frames.only"
        )
    return tuple(chosen)


def split_frames(
    frames: tuple[FrameRef, ...], config: FactoryConfig
) -> dict[str, tuple[FrameRef, ...]]:
    """Train and test frames; a scene is in one of them, never in both.

    Raises FactoryError when a name in split.test matches no scene of a whole data set.
    """
    scenes = sorted({(ref.location, ref.scene) for ref in frames})
    if config.split.test:
        testing = {
            scene
            for scene in scenes
            if any(
                fnmatch.fnmatch(name, pattern)
                for pattern in config.split.test
                for name in (scene[1], "/".join(scene))
            )
        }
    else:
        # By a hash of the name: a scene that is added later moves few others, and no order matters.
        ranked = sorted(
            scenes, key=lambda scene: hashlib.blake2b("/".join(scene).encode()).digest()
        )
        count = round(config.split.test_fraction * len(scenes))
        if config.split.test_fraction > 0 and len(scenes) > 1:
            count = max(count, 1)
        testing = set(ranked[:count])
    return {
        "train": tuple(ref for ref in frames if (ref.location, ref.scene) not in testing),
        "test": tuple(ref for ref in frames if (ref.location, ref.scene) in testing),
    }


def frames_digest(frames: tuple[FrameRef, ...]) -> str:
    """Hash of the names of the frames: a download that has grown makes another dataset."""
    names = "\n".join(ref.name for ref in frames)
    return hashlib.blake2b(names.encode(), digest_size=8).hexdigest()
