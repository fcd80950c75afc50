"""The devices of conf/sonar, composed without the rest of the configuration."""

from __future__ import annotations

from functools import cache
from typing import Any

from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.factory.common.settings import build
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from tests.project_files import ROOT

NAMES = sorted(path.stem for path in (ROOT / "conf" / "sonar").glob("*.yaml"))


@cache
def sonar_preset(name: str) -> SonarSettings:
    """The settings of `sonar=NAME`."""
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose(f"sonar/{name}"), resolve=True)
    settings: SonarSettings = build(SonarSettings, values["sonar"], "sonar")
    return settings
