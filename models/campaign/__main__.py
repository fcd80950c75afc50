"""`python -m models.campaign`: the whole training campaign; run it again to go on."""

from __future__ import annotations

import sys
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from factory.cli import run_app
from factory.settings import build


def run(config: DictConfig) -> int:
    """Do, or show, what the configuration says."""
    from models.campaign.execute import Campaign
    from models.campaign.settings import CampaignSettings

    container = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    settings: CampaignSettings = build(CampaignSettings, cast(dict[str, Any], container))
    campaign = Campaign(settings)
    if settings.show:
        campaign.show()
        return 0
    return campaign()


def main() -> None:
    """Entry point."""
    sys.exit(run_app(run, "campaign"))


if __name__ == "__main__":
    main()
