"""Optional parts of an install: what a command needs of them, and one line for what is missing.

Looks for modules without importing them, so that a run is refused before any work.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple

from ..errors import FactoryError

if TYPE_CHECKING:
    from ..config import FactoryConfig

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
    """A module that something the user asked for cannot do without.

    what: the words that ask for it, for example `render=cycles`.
    instead: words that do without it.
    """

    what: str
    module: str
    instead: str = ""


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
        f"{reasons}: {install_command(*(EXTRAS[need.module] for need in missing))}"
        + (f", or choose {others}" if others else "")
    )


def needs_of(config: FactoryConfig) -> Iterator[Need]:
    """What making the pairs of a configuration needs beyond the core install."""
    # Imports numpy and pydantic, which `simnfnd --help` does without.
    from ..renderer_choice import renderer_of

    image = config.sonar.image
    drawn = config.devices is not None
    renderer = ""
    choice = renderer_of(config)
    if config.scenes.kind != "pack":
        renderer = choice.settings.kind
    # Without shadow rays the closed form is wrong for a sonar away from the camera.
    colocated = config.sonar.mount.colocated
    other_than_cycles = "render=analytic or render=embree" if colocated else "render=embree"
    coherent = config.acoustics.formation == "coherent" and not drawn
    jpeg = f"sonar.image.jpeg_quality={image.jpeg_quality}"
    enlarged = f"sonar.image.enlarged={image.enlarged:g}"
    to_s3 = (config.dataset.dir or "").startswith("s3://")
    for asked, *need in (
        (renderer == "cycles", choice.reason, "bpy", other_than_cycles),
        (renderer == "embree", "render=embree", "open3d", "render=analytic or render=cycles"),
        (image.enlarged > 1, enlarged, "cv2", "sonar.image.enlarged=1"),
        (image.jpeg_quality is not None, jpeg, "cv2", "sonar.image.jpeg_quality=null"),
        (drawn, "devices=any_sonar", "cv2"),
        (drawn, "devices=any_sonar", "scipy"),
        (coherent, "acoustics=coherent", "scipy", "acoustics=pointwise noise=simnfnd"),
        ("pose" in config.dataset.columns, "dataset.columns=[pose]", "scipy"),
        (config.scheduler.backend == "dask", "scheduler=dask", "distributed", "scheduler=local"),
        (to_s3, "dataset.dir=s3://...", "s3fs", "a folder of this machine"),
    ):
        if asked:
            yield Need(*map(str, need))
