"""`sonar.altitude_m` and `sonar.tilt_deg`: the sonar is where the user says, whatever its mount."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.labels.insonified import insonified_share
from simnfnd.factory.simulation.pairs.pair_maker import observe
from simnfnd.factory.simulation.pairs.requested_columns import pose_row
from simnfnd.factory.simulation.render.base import Rendered
from simnfnd.factory.simulation.scenes import open_reader
from tests.frames import ground_and_post, plain_render

PLACE = (
    *("scenes.locations=1", "scenes.frames_per_location=2", "scenes.width=96", "scenes.height=61"),
    *("sonar.altitude_m=1.2", "sonar.tilt_deg=20"),
)
MOUNT = "sonar.mount={pitch_deg: 12, yaw_deg: 15, translation_m: [0.2, 0.1, 0.3]}"


def poses(config: FactoryConfig) -> list[tuple[float, float]]:
    """Altitude, m, and tilt, degrees, of the sonar in each frame."""
    reader = open_reader(config.scenes)
    rows = [pose_row(reader.load(ref), config.sonar.mount) for ref in reader.discover().frames]
    return [(float(row["sonar.altitude_m"]), float(row["sonar.tilt_deg"])) for row in rows]


@pytest.mark.parametrize("mount", [(), (MOUNT,)])
def test_the_sonar_of_a_place_is_so_high_and_looks_so_far_down(mount: tuple[str, ...]) -> None:
    actual = poses(compose_config([*PLACE, *mount]))
    assert np.array(actual) == pytest.approx(np.array([(1.2, 20.0)] * 2), abs=1e-3)


@pytest.mark.slow
def test_height_and_tilt_are_drawn_for_each_frame_and_once_for_a_recording() -> None:
    drawn = ("sonar.altitude_m={uniform: [0.8, 1.6]}", "sonar.tilt_deg={choice: [15, 25, 35]}")
    apart = poses(compose_config([*PLACE[:4], *drawn, "scenes.frames_per_location=3"]))
    assert len({round(altitude_m, 4) for altitude_m, _ in apart}) == 3
    assert all(0.799 < altitude_m < 1.601 for altitude_m, _ in apart)
    assert {round(tilt_deg) for _, tilt_deg in apart} <= {15, 25, 35}
    recorded = poses(compose_config([*PLACE[:4], *drawn, "scenes.frame_rate_hz=5"]))
    assert recorded[0] == recorded[1]


@pytest.mark.parametrize("route", ["orbit", "transect"])
def test_the_sonar_of_a_drawn_path_does_too(route: str, tmp_path: Path) -> None:
    ground = "v -9 -9 0\nv 9 -9 0\nv 9 9 0\nv -9 9 0\nf 1 2 3\nf 1 3 4\n"
    (tmp_path / "ground.obj").write_text(ground)
    words = ["scenes=mesh", f"scenes.file={tmp_path}/ground.obj", f"scenes.route={route}"]
    words += ["scenes.paths=1", "scenes.views_per_path=4", "scenes.speed_m_s=6", *PLACE[2:]]
    # A transect begins beside the ground.
    actual = [pose for pose in poses(compose_config(words)) if np.isfinite(pose[0])]
    assert len(actual) >= 2
    assert np.array(actual) == pytest.approx(np.array([(1.2, 20.0)] * len(actual)), abs=1e-3)


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("scenes=flsea", "scenes.root=x", "sonar.tilt_deg=20"), "sonar.tilt_deg"),
        (("scenes=mesh", "scenes.file=a.ply", "scenes.poses=b.txt", "sonar.altitude_m=2"),
         "sonar.altitude_m"),
        (("sonar.tilt_deg=80", "sonar.mount.yaw_deg=60"), "sonar.tilt_deg"),
        (("sonar.altitude_m=2", "sonar.mount.translation_m=[1,0,0]"), "sonar.altitude_m"),
    ],
)  # fmt: skip
def test_what_it_cannot_be_is_refused_by_name(words: tuple[str, ...], key: str) -> None:
    with pytest.raises(FactoryError) as caught:
        compose_config(words)
    assert str(caught.value).startswith(key)


def test_frames_with_echoes_in_few_beams_are_refused() -> None:
    frame = ground_and_post()
    whole = plain_render(frame)
    left = np.zeros_like(whole.surface)
    left[:, : left.shape[1] // 8] = True
    narrow = Rendered(np.where(left, whole.radiance, np.float32(0)), whole.surface)
    for words, rendered, is_refused in (
        ((), narrow, False),
        (("frames.min_insonified=0.2",), narrow, True),
        (("frames.min_insonified=0.2",), whole, False),
    ):
        config = compose_config(words)
        if is_refused:
            with pytest.raises(FrameError, match=r"frames\.min_insonified"):
                observe(frame, rendered, config)
            continue
        observed_frame = observe(frame, rendered, config)
        share = insonified_share(observed_frame.scene.filled, observed_frame.window, config.sonar)
        assert (share < 0.2) == (rendered is narrow)
