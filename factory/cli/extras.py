"""Optional parts of an install: what a command needs of them, and one line for what is missing.

Looks for modules without importing them, so that a run is refused before any work.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

from ..errors import FactoryError

if TYPE_CHECKING:
    from ..config import FactoryConfig

EXTRAS = {
    "cv2": "sonar",
    "scipy": "sonar",
    "bpy": "blender",
    "open3d": "open3d",
    "torch": "train",
    "safetensors": "denoise",
    "optuna": "report",
    "pandas": "report",
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


@dataclass(frozen=True)
class Need:
    """A module that something the user asked for cannot do without.

    what: the words that ask for it, for example `render=cycles`.
    instead: words that do without it.  extra: where more than one extra brings the module.
    """

    what: str
    module: str
    instead: str = ""
    extra: str = ""

    @property
    def installed_by(self) -> str:
        """The name of the extra."""
        return self.extra or EXTRAS[self.module]


def install_command(*extras: str) -> str:
    """The line that installs `extras`, as a shell takes it."""
    return f'pip install "simnfnd[{",".join(dict.fromkeys(extras))}]"'


def require(needs: Iterable[Need]) -> None:
    """Raise FactoryError, one line, unless all modules are installed."""
    missing = [need for need in needs if find_spec(need.module) is None]
    if not missing:
        return
    modules: dict[str, list[str]] = {}
    for need in missing:
        modules.setdefault(need.what, []).append(need.module)
    reasons = ", ".join(f"{what} needs {' and '.join(names)}" for what, names in modules.items())
    others = "; ".join(dict.fromkeys(need.instead for need in missing if need.instead))
    raise FactoryError(
        f"{reasons}: {install_command(*(need.installed_by for need in missing))}"
        + (f", or choose {others}" if others else "")
    )


def needs_of(config: FactoryConfig) -> Iterator[Need]:
    """What making the pairs of a configuration needs beyond the core install."""
    packed = config.scenes.kind == "pack"
    if not packed and config.render.kind == "cycles":
        yield Need("render=cycles", "bpy", "render=analytic or render=embree")
    if not packed and config.render.kind == "embree":
        yield Need("render=embree", "open3d", "render=analytic or render=cycles")
    if not packed and getattr(config.scenes, "undistort", False):
        yield Need("scenes.undistort=true", "cv2", "scenes.undistort=false")
    image = config.sonar.image
    if image.enlarged > 1:
        yield Need(f"sonar.image.enlarged={image.enlarged:g}", "cv2", "sonar.image.enlarged=1")
    if image.jpeg_quality is not None:
        key = "sonar.image.jpeg_quality"
        yield Need(f"{key}={image.jpeg_quality}", "cv2", f"{key}=null")
    if config.devices is not None:
        yield from (Need("devices=any_sonar", module) for module in ("cv2", "scipy"))
    elif config.acoustics.formation == "field":
        yield Need("acoustics.formation=field", "scipy", "acoustics=points noise=simnfnd")
    if "pose" in config.dataset.columns:
        yield Need("dataset.columns=[pose]", "scipy", "dataset.columns=[]")
    if config.scheduler.backend == "dask":
        yield Need("scheduler=dask", "distributed", "scheduler=local")
    if (config.dataset.dir or "").startswith("s3://"):
        yield Need("dataset.dir=s3://...", "s3fs", "a folder of this machine")
