"""Optional parts of an install: which of them a command requires, and one line for missing ones.

Searches for modules without importing them, so that a run is refused before it does any work.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple

from ...common.errors import FactoryError

if TYPE_CHECKING:
    from ...simulation.config.root import FactoryConfig

EXTRAS = {
    "cv2": "sonar",
    "av": "sonar",
    "scipy": "sonar",
    "bpy": "blender",
    "open3d": "open3d",
    "torch": "train",
    "safetensors": "denoise",
    "optuna": "report",
    "pandas": "report",
    "pycocotools": "report",
    "pyarrow": "export",
    "skimage": "report",
    "jinja2": "report",
    "distributed": "cluster",
    "huggingface_hub": "export",
    "webdataset": "export",
    "onnx": "onnx",
    "onnxruntime": "denoise",
    "matplotlib": "figures",
    "rosbags": "ros",
    "hdf5plugin": "zstd",
    "s3fs": "cloud",
}
"""Module -> the extra of pyproject.toml that installs it."""


class Need(NamedTuple):
    """A module that a choice of the user requires.

    choice: the override that requires it, for example `render=cycles`.
    instead: overrides that do not require it; empty: there are none.
    """

    choice: str
    module: str
    instead: str = ""


def install_command(*extras: str) -> str:
    """Return the shell command that installs `extras`."""
    return f'pip install "simnfnd[{",".join(dict.fromkeys(extras))}]"'


def require(needs: Iterable[Need]) -> None:
    """Raise FactoryError, one line, unless all modules are installed."""
    missing = [need for need in needs if find_spec(need.module) is None]
    if not missing:
        return

    modules_of_choice: dict[str, list[str]] = {}
    for need in missing:
        modules_of_choice.setdefault(need.choice, []).append(need.module)
    reasons = ", ".join(
        f"{choice} needs {' and '.join(modules)}" for choice, modules in modules_of_choice.items()
    )
    remedy = install_command(*(EXTRAS[need.module] for need in missing))
    others = "; ".join(dict.fromkeys(need.instead for need in missing if need.instead))
    if others:
        remedy += f", or choose {others}"
    raise FactoryError(f"{reasons}: {remedy}")


def needs_of(config: FactoryConfig) -> Iterator[Need]:
    """What making the pairs of a configuration needs beyond the core install."""
    yield from _needs_of_renderer(config)
    yield from _needs_of_images(config)
    if "pose" in config.dataset.columns:
        yield Need("dataset.columns=[pose]", "scipy")
    if config.scheduler.backend == "dask":
        yield Need("scheduler=dask", "distributed", "scheduler=local")
    if (config.dataset.dir or "").startswith("s3://"):
        yield Need("dataset.dir=s3://...", "s3fs", "a folder of this machine")


def _needs_of_renderer(config: FactoryConfig) -> Iterator[Need]:
    # Imports numpy and pydantic, which `simnfnd --help` does without.
    from ...simulation.config.renderer_choice import renderer_of

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
