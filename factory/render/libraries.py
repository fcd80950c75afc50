"""What to tell the user when the library behind a renderer is not there."""

from __future__ import annotations

from importlib.util import find_spec

from ..errors import FactoryError

MODULE = {"cycles": "bpy", "embree": "open3d"}

_INSTALL = {
    "cycles": 'pip install "simnfnd[blender]" (Python 3.11)',
    "embree": 'pip install "simnfnd[open3d]"',
}
_OTHERS = {
    "cycles": "render=analytic or render=embree",
    "embree": "render=analytic or render=cycles",
}


def missing(kind: str, reason: object) -> FactoryError:
    """The error for a renderer whose module cannot be imported, with the way out of it."""
    what = str(reason).splitlines()[0] if str(reason) else "not installed"
    # The module is there, but a shared library of the operating system is not.
    remedy = "make setup installs what it needs" if ".so" in what else _INSTALL[kind]
    return FactoryError(
        f"render.kind={kind} needs the module {MODULE[kind]} ({what}): "
        f"{remedy}, or choose {_OTHERS[kind]}"
    )


def check_installed(kind: str) -> None:
    """Raise FactoryError when the renderer's module is not installed.  Imports nothing."""
    module = MODULE.get(kind)
    if module is not None and find_spec(module) is None:
        raise missing(kind, "not installed")
