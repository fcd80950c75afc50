"""What other packages add: effects, readers of scenes and recordings, methods, metrics, presets.

A package names its objects as entry points, so that the command line and worker processes know
them; a script or notebook registers its own (`simnfnd.extensions`).  An object is imported when it
is first asked for.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

from .errors import FactoryError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")
Kind = Literal["effect", "reader", "recording", "method", "metric", "network", "preset"]
GROUPS: dict[Kind, str] = {
    "effect": "simnfnd.effects",
    "reader": "simnfnd.readers",
    "recording": "simnfnd.recordings",
    "method": "simnfnd.methods",
    "metric": "simnfnd.metrics",
    "network": "simnfnd.networks",
    "preset": "simnfnd.presets",
}
"""Kind of extension -> group of entry points; readers are of RGBD scenes, recordings of sonars."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


class ExtensionSource(NamedTuple):
    """Where an extension comes from.

    package, version: of the distribution that names it; "" for what a script registers.
    """

    package: str = ""
    version: str = ""

    def __str__(self) -> str:
        return f"{self.package} {self.version}" if self.package else "registered in Python"


class Extension(NamedTuple):
    """One object of another package or of the user's code."""

    kind: Kind
    name: str
    value: Any
    source: ExtensionSource


_registered: dict[tuple[Kind, str], Extension] = {}


def register(kind: Kind, name: str, value: Any, source: ExtensionSource | None = None) -> Extension:
    """Make an object known by its name in this process; a later one of the name replaces it.

    Raises ValueError for a name that is not lower-case letters, digits and underscores.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r}: name a {kind} by lower-case letters, digits and underscores")
    extension = Extension(kind, name, value, source or ExtensionSource())
    _registered[kind, name] = extension
    return extension


def _is_declared() -> bool:
    """Whether an installed package names any extension.

    Looks for the group in the files themselves: `importlib.metadata` takes longer to load and parse
    them than all else that help needs.
    """
    for folder in dict.fromkeys(sys.path):
        names: list[str] = []
        with suppress(OSError):
            names = [name for name in os.listdir(folder or ".") if name.endswith("-info")]
        for name in names:
            with suppress(OSError), open(f"{folder}/{name}/entry_points.txt", "rb") as file:
                if b"[simnfnd." in file.read():
                    return True
    return False


@cache
def _entry_points(kind: Kind) -> dict[str, EntryPoint]:
    if not _is_declared():
        return {}
    from importlib import metadata

    return {point.name: point for point in metadata.entry_points(group=GROUPS[kind])}


def names(kind: Kind) -> list[str]:
    """Names of all extensions of a kind; imports none of them."""
    registered = (name for registered_kind, name in _registered if registered_kind == kind)
    return list(dict.fromkeys((*registered, *_entry_points(kind))))


def source_of(kind: Kind, name: str) -> ExtensionSource:
    """Where an extension comes from; imports nothing."""
    if (kind, name) in _registered:
        return _registered[kind, name].source
    distribution = _entry_points(kind)[name].dist
    return (
        ExtensionSource(distribution.name, distribution.version)
        if distribution
        else ExtensionSource()
    )


def find(kind: Kind, name: str) -> Extension | None:
    """The extension of a name, imported; None where there is none.

    Raises FactoryError, one line, for one that cannot be imported.
    """
    if (kind, name) not in _registered:
        point = _entry_points(kind).get(name)
        if point is None:
            return None
        source = source_of(kind, name)
        try:
            value = point.load()
        except Exception as error:  # the code of another package
            raise FactoryError(
                f"{kind} {name}: {source} cannot be loaded ({type(error).__name__}: {error}); "
                "repair the package, or uninstall it"
            ) from error
        # Its module may have registered it meanwhile.
        register(kind, name, value, source)
    return _registered[kind, name]


def find_of_type(kind: Kind, name: str, expected: type[T]) -> T | None:
    """Return the object of a name; None where there is none.

    Raises FactoryError for one that cannot be imported, has another type or another name.
    """
    extension = find(kind, name)
    if extension is None:
        return None
    value = extension.value
    if not isinstance(value, expected) or getattr(value, "name", name) != name:
        raise FactoryError(
            f"{kind} {name}: {extension.source} gives no {expected.__name__} of that name; report "
            "it to the package's author"
        )
    return value


def preset_module(name: str) -> str:
    """The module whose folders of YAML files are choices of groups, such as `mine.presets`."""
    point = _entry_points("preset").get(name)
    return point.value if point is not None else str(_registered["preset", name].value)


def provenance(kind: Kind, name: str) -> dict[str, str]:
    """What manifests say of an extension: kind, name, package, version and hash of its source.

    Raises FactoryError where it is not installed.
    """
    extension = find(kind, name)
    if extension is None:
        raise FactoryError(f"{kind} {name}: not installed; install the package that has it")
    return {
        "kind": kind,
        "name": name,
        "package": extension.source.package,
        "version": extension.source.version,
        "source": source_hash(defined_parts(extension.value)),
    }


def defined_parts(value: Any) -> list[Any]:
    """The functions and classes that an extension's object is made of."""
    import inspect

    parts = [value, *vars(value).values()] if hasattr(value, "__dict__") else [value]
    return [part for part in parts if inspect.isfunction(part) or inspect.isclass(part)]


def source_hash(parts: Iterable[Any]) -> str:
    """16 hexadecimal digits of the files that define functions and classes.

    What was typed into an interpreter counts by its names.
    """
    import hashlib

    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        module = sys.modules.get(part.__module__)
        path = getattr(module, "__file__", None)
        digest.update(f"{part.__module__}.{part.__qualname__}\0".encode())
        if path is not None and Path(path).is_file():
            digest.update(Path(path).read_bytes())
    return digest.hexdigest()


def refuse_main(kind: Kind, name: str) -> None:
    """Raise FactoryError for an object of `__main__`, which worker processes cannot import."""
    extension = _registered.get((kind, name))
    parts = defined_parts(extension.value) if extension else []
    if any(part.__module__ == "__main__" for part in parts):
        raise FactoryError(
            f"{kind} {name}: is defined in the script or notebook itself, which worker processes "
            "do not import; move it into a module, or set scheduler=serial"
        )


def listed() -> list[str]:
    """A line for each kind that has extensions: their names and packages; imports none of them."""
    lines = []
    for kind in GROUPS:
        origins = [f"{name} ({source_of(kind, name)})" for name in names(kind)]
        if origins:
            lines.append(f"{kind}s of other packages: {', '.join(origins)}")
    return lines
