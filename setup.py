"""Which packages an installation has; everything else stands in pyproject.toml.

`simnfnd/factory`, `models`, `evaluation` and `conf` are links to the folders beside the package.
An archive may turn links into text files; the packages are then those of the folders themselves.
"""

from pathlib import Path

from setuptools import find_namespace_packages, setup

ROOMS = ("factory", "models", "evaluation", "conf")
ROOT = Path(__file__).parent

if all((ROOT / "simnfnd" / room).is_dir() for room in ROOMS):
    # "." makes an editable installation a plain path instead of an import hook.
    folders = {"": "."}
    packages = find_namespace_packages(str(ROOT), include=["simnfnd*"])
else:
    folders = {f"simnfnd.{room}": room for room in ROOMS}
    packages = ["simnfnd"]
    for room in ROOMS:
        names = [room, *(f"{room}.{name}" for name in find_namespace_packages(str(ROOT / room)))]
        packages += [f"simnfnd.{name}" for name in names]

setup(packages=packages, package_dir=folders)
