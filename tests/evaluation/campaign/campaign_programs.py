"""A campaign's settings, and commands that only note what is asked and leave weights behind."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.evaluation.campaign.settings import CampaignSettings
from simnfnd.factory.settings import build
from simnfnd.models import build_network
from simnfnd.models.networks.weights import save_weights

TINY = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 0, "decoder": [1]}
ROWS = (
    "rows=[{name: a, cpu_s: 20.5, words: ['model=nafnet'], seeds: [0, 1]},"
    "{name: b, cpu_s: 10.5, words: []}]"
)


def settings(out: Path, *words: str) -> CampaignSettings:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("campaign", [f"out='{out}'", *words]))
    result: CampaignSettings = build(CampaignSettings, values)
    return result


class Programs:
    """Instead of processes; `fails`: what a command has in it that ends with code 2.

    asked: (verb, words) in the order of beginning.  stopped: how `stop` was called.
    """

    def __init__(self, *, fails: str = "") -> None:
        self.asked: list[tuple[str, tuple[str, ...]]] = []
        self.stopped: list[bool] = []
        self.fails = fails
        self._one_at_a_time = threading.Lock()

    def __call__(self, verb: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        with self._one_at_a_time:
            self.asked.append((verb, tuple(words)))
            given = dict(word.split("=", 1) for word in words if "=" in word)
            # 10 ms a step; coming and going takes longer, and not always the same time.
            trained = sum(one == "train" for one, _ in self.asked)
            coming = (3.0, 2.2, 3.1)[(trained + 1) % 3] if verb == "train" else 3.0
            cpu_s = coming + 0.01 * int(given.get("train.steps", 0))
            if self.fails and any(self.fails in word for word in words):
                return 2, cpu_s
            if verb == "train":
                out = Path(given["out"].strip("'"))
                out.mkdir(parents=True, exist_ok=True)
                torch.manual_seed(int(given["seed"]))
                save_weights(out / "weights.safetensors", build_network(TINY), TINY, {})
            return 0, cpu_s

    def stop(self, *, signalled: bool) -> None:
        self.stopped.append(signalled)

    def steps(self, verb: str) -> list[str]:
        return [word for v, words in self.asked for word in words if v == verb]
