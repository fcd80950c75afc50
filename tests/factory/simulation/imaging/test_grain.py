"""Grain that stays with the world while the sonar turns and moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage, stats

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.root import from_mapping, plain
from simnfnd.factory.simulation.moving.recordings import MovingRecordings
from simnfnd.factory.simulation.pairs.pair_maker import make_pair, observe_moment
from simnfnd.factory.simulation.pairs.views import ViewMaker
from tests.constant_field import config

BEAM_DEG = 90 / 256
POSES = {
    "first": (0.0, 0.0),
    "one beam": (0.0, BEAM_DEG),
    "twenty beams": (0.0, -20 * BEAM_DEG),
    "ahead": (0.002, 0.0),
    "again": (0.0, 0.0),
}
WORDS = (
    "experiment=physical", "sonar=oculus_c550d_hf", "sonar.image.layout=polar",
    "sonar.range={auto: false, min_m: .2, max_m: 10}", "sonar.range_bins=256", "render=analytic",
    "scenes=seabed", "scenes.locations=1", "scenes.frame_rate_hz=10", "scenes.width=726",
    "scenes.height=456",
)  # fmt: skip


@pytest.fixture(scope="module")
def views(tmp_path_factory: Any) -> tuple[str, list[Any]]:
    path = Path(tmp_path_factory.mktemp("grain")) / "poses.csv"
    lines = [f"{surge_m},{yaw_deg}" for surge_m, yaw_deg in POSES.values()]
    path.write_text("surge_m,yaw_deg\n" + "\n".join(lines) + "\n")
    maker = ViewMaker(compose_config([*WORDS, f"scenes.path={path}"]))
    return str(path), [(ref, maker.render(ref)) for ref in maker.reader.discover().frames]


def grain(image: Any) -> Any:
    return image / np.maximum(ndimage.uniform_filter(image, 9), 1e-6 * image.max())


@pytest.mark.parametrize(
    ("noise", "least"), [("physical", (0.76, 0.54, 0.86)), ("moving", (0.70, 0.52, 0.82))]
)
def test_grain_stays_with_the_world(views, noise, least):
    path, rendered = views

    def images(seed: int) -> list[Any]:
        settings = compose_config([*WORDS, f"scenes.path={path}", f"noise={noise}", f"seed={seed}"])
        recordings = MovingRecordings(settings.scenes, seed)
        moments = [recordings.moment(view.frame(ref), view.rendered()) for ref, view in rendered]
        pairs = [make_pair(observe_moment(moment, settings), 0, settings) for moment in moments]
        return [pair.noisy.astype(float) for pair in pairs]

    first, one_beam, twenty_beams, ahead, again = images(1)
    level = ndimage.uniform_filter(first, 9)
    lit = level > 0.08 * level.max()
    lit[:, :24] = lit[:, -24:] = False

    def likeness(image: Any, beams: int = 0) -> float:
        rolled = np.roll(grain(image), beams, axis=1)
        return float(stats.spearmanr(grain(first)[lit], rolled[lit])[0])

    unlike = likeness(images(2)[0])
    alike = likeness(again)
    kept = [
        (max(likeness(image, beams) for beams in (-shift, shift)) - unlike) / (alike - unlike)
        for image, shift in ((one_beam, 1), (twenty_beams, 20), (ahead, 0))
    ]
    assert all(part >= least_part for part, least_part in zip(kept, least, strict=True)), kept


def test_a_removed_key_is_named_and_its_default_accepted() -> None:
    values = plain(config(noise={"speckle": {}}))
    values["noise"]["speckle"]["scatterer_m"] = 0
    assert from_mapping(values).noise.speckle is not None
    values["noise"]["speckle"]["scatterer_m"] = 0.02
    with pytest.raises(FactoryError, match=r"noise\.speckle\.scatterer_m: was removed"):
        from_mapping(values)
    with pytest.raises(FactoryError, match="was removed"):
        compose_config(["experiment=physical", "noise.speckle.scatterer_m=0.02"])
