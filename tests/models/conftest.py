"""What all tests of networks share."""

from __future__ import annotations

import pytest
import torch


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> None:
    # Tiny networks gain nothing from more, and test runs side by side would fight for cores.
    torch.set_num_threads(1)
