"""Optional parts of an install that making the pairs of a configuration requires."""

from __future__ import annotations

from collections.abc import Iterator

from ...common.extras import Need
from .renderer_choice import renderer_of
from .root import FactoryConfig


def needs_of(config: FactoryConfig) -> Iterator[Need]:
    """Yield what making the pairs of `config` requires beyond the core install."""
    yield from _needs_of_renderer(config)
    yield from _needs_of_images(config)
    if "pose" in config.dataset.columns:
        yield Need("dataset.columns=[pose]", "scipy")
    if config.scheduler.backend == "dask":
        yield Need("scheduler=dask", "distributed", "scheduler=local")
    if (config.dataset.dir or "").startswith("s3://"):
        yield Need("dataset.dir=s3://...", "s3fs", "a folder of this machine")


def _needs_of_renderer(config: FactoryConfig) -> Iterator[Need]:
    if config.scenes.kind == "pack":
        return
    choice = renderer_of(config)
    if choice.settings.kind == "cycles":
        # Without shadow rays the closed form is wrong for a sonar away from the camera.
        colocated = config.sonar.mount.colocated
        others = "render=analytic or render=embree" if colocated else "render=embree"
        yield Need(str(choice.reason), "bpy", others)
    if choice.settings.kind == "embree":
        yield Need("render=embree", "open3d", "render=analytic or render=cycles")


def _needs_of_images(config: FactoryConfig) -> Iterator[Need]:
    image = config.sonar.image
    is_device_drawn = config.devices is not None
    if image.enlarged > 1:
        yield Need(f"sonar.image.enlarged={image.enlarged:g}", "cv2", "sonar.image.enlarged=1")
    if image.jpeg_quality is not None:
        jpeg = f"sonar.image.jpeg_quality={image.jpeg_quality}"
        yield Need(jpeg, "cv2", "sonar.image.jpeg_quality=null")
    if is_device_drawn:
        yield Need("devices=any_sonar", "cv2")
        yield Need("devices=any_sonar", "scipy")
    elif config.acoustics.formation == "coherent":
        yield Need("acoustics=coherent", "scipy", "acoustics=pointwise noise=simnfnd")
