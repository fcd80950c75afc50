"""`simnfnd campaign`: the whole training campaign; run it again to go on."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from ...factory.cli import run_app
from ...factory.settings import build


def main(words: Sequence[str]) -> int:
    """Run the campaign; returns the exit code."""
    sys.argv[1:] = words
    return run_app(run, "campaign")


def run(config: DictConfig) -> int:
    """Do, or show, what the configuration says."""
    from .execute import Campaign
    from .settings import CampaignSettings

    container = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    settings: CampaignSettings = build(CampaignSettings, cast(dict[str, Any], container))
    campaign = Campaign(settings)
    if settings.show:
        campaign.show()
        return 0
    return campaign()
