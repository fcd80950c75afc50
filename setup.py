"""The rooms of the checkout under one name: folder `factory` is `simnfnd.factory`, and so on.

Everything else that an install needs stands in pyproject.toml.
"""

from setuptools import find_packages, setup

ROOMS = ("factory", "models", "evaluation", "conf")

setup(
    package_dir={"simnfnd": "simnfnd"} | {f"simnfnd.{room}": room for room in ROOMS},
    packages=["simnfnd"]
    + [
        f"simnfnd.{package}"
        for room in ROOMS
        for package in find_packages(include=[room, f"{room}.*"])
    ],
)
