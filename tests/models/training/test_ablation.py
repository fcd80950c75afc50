"""`experiment=ablation`: every variant is a training that can begin."""

from __future__ import annotations

from pathlib import Path

import pytest

from simnfnd.models.networks import build_network
from simnfnd.models.settings import MixedData
from tests.models.data.small_renders import composed
from tests.project_files import ROOT

VARIANTS = sorted(path.stem for path in (ROOT / "conf/ablation").glob("*.yaml"))


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_is_a_training_of_its_own(variant: str) -> None:
    settings, _ = composed("experiment=ablation", f"ablation={variant}")
    whole, _ = composed("experiment=ablation", "ablation=both")
    assert settings.name.startswith("ablation-")
    assert (settings.name == whole.name) == (variant == "both")
    assert settings.start is None
    assert settings.train == whole.train
    build_network(settings.model)
    assert isinstance(settings.data, MixedData)
    assert settings.data.points_share + settings.data.recordings_share <= 1
    parts = [settings.model, settings.loss, settings.data]
    assert (parts == [whole.model, whole.loss, whole.data]) == (variant == "both")


def test_the_table_of_variants_is_complete() -> None:
    page = Path(ROOT / "docs/models.md").read_text(encoding="utf-8")
    assert [name for name in VARIANTS if f"`{name}`" not in page] == []
