"""`Sonar.ping`: the bytes of `simnfnd make`, what is lazy, errors, and memory."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd import FactoryError, PairDataset, Pose, Sonar, make_dataset

SMALL = (
    "scenes.width=200", "scenes.height=128", "sonar.range.min_m=0.5", "sonar.range.max_m=8",
    "sonar.range_bins=128", "sonar.beams=96",
)  # fmt: skip
MOVES = ((0.0, 0.0, 0.0), (0.2, 0.05, 4.0), (-0.1, 0.0, -9.0))
LOOKS = ((0.0, -3.0, 0.8), (0.4, -2.5, 1.0), (-0.6, -2.0, 0.7))
DOWN_DEG = 25.0


def quaternion() -> tuple[float, float, float, float]:
    """Optical axes that look along +y and down, in a world with z up."""
    half_rad = math.radians(-90 - DOWN_DEG) / 2
    return math.sin(half_rad), 0.0, 0.0, math.cos(half_rad)


def write_world(folder: Path) -> Path:
    """A wavy floor with a box on it."""
    side = np.linspace(-6, 6, 49)
    x, y = np.meshgrid(side, side)
    z = 0.08 * np.sin(2 * x) * np.cos(1.5 * y)
    lines = [f"v {a:.4f} {b:.4f} {c:.4f}" for a, b, c in zip(x.flat, y.flat, z.flat, strict=True)]
    faces = [
        (row * 49 + column + 1, row * 49 + column + 2, (row + 1) * 49 + column + 2)
        for row in range(48)
        for column in range(48)
    ]
    faces += [(a, c, c - 1) for a, _, c in faces]
    lines += ["o floor"] + [f"f {a} {b} {c}" for a, b, c in faces]
    first = 49 * 49 + 1
    for corner in range(8):
        lines.append(f"v {corner & 1} {corner >> 1 & 1} {0.7 * (corner >> 2)}")
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    lines += ["o box"] + ["f " + " ".join(str(first + place) for place in quad) for quad in quads]
    path = folder / "world.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def scene_of(tmp_path_factory: Any) -> dict[str, Any]:
    """Of each kind: its words, poses, and the word that gives `make` the same poses."""
    folder = Path(tmp_path_factory.mktemp("pings"))
    path = folder / "path.csv"
    rows = "\n".join(",".join(map(str, move)) for move in MOVES)
    path.write_text(f"surge_m,sway_m,yaw_deg\n{rows}\n")
    turn = quaternion()
    poses = folder / "poses.txt"
    poses.write_text(
        "\n".join(" ".join(map(str, (number, *look, *turn))) for number, look in enumerate(LOOKS))
        + "\n"
    )
    return {
        "seabed": (
            ("scenes.first_location=2",),
            [Pose(surge_m=surge, sway_m=sway, yaw_deg=yaw) for surge, sway, yaw in MOVES],
            f"scenes.path={path}",
        ),
        "mesh": (
            (f"scenes.file={write_world(folder)}", "scenes.up=z"),
            [Pose(position_m=look, quaternion=turn) for look in LOOKS],
            f"scenes.poses={poses}",
        ),
    }


@pytest.mark.parametrize("layout", ["polar", "fan"])
@pytest.mark.parametrize("kind", ["seabed", "mesh"])
def test_pings_have_the_bytes_of_make_in_any_order(kind, layout, scene_of, tmp_path):
    words, poses, recorded = scene_of[kind]
    words = (*SMALL, *words, f"sonar.image.layout={layout}")
    with Sonar(kind, sonar="oculus_c550d_hf", seed=3, overrides=words) as sonar:
        pings = {index: sonar.ping(poses[index], index=index) for index in (2, 0, 1)}
        images = {index: (ping.noisy, ping.clean, ping.fan) for index, ping in pings.items()}
    made = make_dataset(
        *sonar.words, recorded, *(["scenes.locations=1"] if kind == "seabed" else []),
        "split.test=['*']", "scheduler=serial", f"cache.dir={tmp_path}/cache",
        out=tmp_path / "pairs",
    )  # fmt: skip
    assert made.pairs == len(poses)
    with PairDataset(tmp_path / "pairs", "test") as pairs:
        for index in range(len(poses)):
            pair = pairs.pair(index)
            noisy, clean, fan = images[index]
            np.testing.assert_array_equal(noisy, pair.noisy)
            np.testing.assert_array_equal(clean, pair.clean)
            if layout == "fan":
                np.testing.assert_array_equal(fan, pair.noisy)
    assert noisy.std() > 5


def test_a_ping_tells_what_is_in_it(scene_of):
    words, poses, _ = scene_of["mesh"]
    labelled = (*SMALL, *words, "scenes.classes=[{parts: box, class: Crate}]")
    with Sonar("mesh", overrides=labelled) as sonar:
        ping = sonar.ping(poses[0])
        assert "labels" not in vars(ping)
        assert ping.labels.segmentation.shape == ping.noisy.shape == ping.elevation.shape
        assert set(np.unique(ping.labels.instance)) == {0, 1}
        (box,) = ping.boxes
    points = ping.points
    of_box = points[points["instance"] == 1]
    assert len(of_box) > 20
    range_m = np.sqrt(sum(points[axis].astype(float) ** 2 for axis in "xyz"))
    assert 0.5 <= range_m.min() < range_m.max() <= 8
    centre_m = np.array(box["centre_m"])
    for axis, middle in zip("xyz", centre_m, strict=True):
        assert np.median(of_box[axis]) == pytest.approx(middle, abs=0.7)
    assert ping.geometry.range_max_m == 8
    assert ping.world["sonar.z_m"] == pytest.approx(LOOKS[0][2])


def test_what_a_caller_can_correct_is_one_line(scene_of):
    for arguments, match in (
        ({"scene": "flsea"}, "poses are recorded"),
        ({"sonar": "oculus_x"}, "no such choice"),
        ({"overrides": ["sonar.beems=3"]}, "no such key"),
        ({"overrides": ["devices=any_sonar"]}, "devices"),
    ):
        with pytest.raises(FactoryError, match=match):
            Sonar(**arguments)
    with pytest.raises(FactoryError, match="yaw_deg"):
        Pose(yaw_deg=math.nan)
    with pytest.raises(FactoryError, match="quaternion"):
        Pose(quaternion=(0, 0, 0, 0))
    sonar = Sonar("seabed", overrides=SMALL)
    with pytest.raises(FactoryError, match="below the seabed"):
        sonar.ping(Pose(heave_m=-30))
    with pytest.raises(FactoryError, match="pose: "):
        sonar.ping(Pose(heave_m=80))
    with pytest.raises(FactoryError, match="position_m"):
        sonar.ping(Pose(position_m=(0, 0, 0)))
    with pytest.raises(FactoryError, match="index"):
        sonar.ping(index=-1)
    with pytest.raises(FactoryError, match="time_s"):
        sonar.ping(time_s=math.inf)
    sonar.close()
    with pytest.raises(FactoryError, match="closed"):
        sonar.ping()
    words, _, _ = scene_of["mesh"]
    with (
        Sonar("mesh", overrides=(*SMALL, *words)) as mesh_sonar,
        pytest.raises(FactoryError, match="position_m"),
    ):
        mesh_sonar.ping(Pose(surge_m=1))


def test_moving_objects_follow_the_time():
    fish = "scenes.moving_objects=[{per_place: [6, 6]}]"
    words = (*SMALL, fish, "scenes.first_location=2")
    with Sonar("seabed", overrides=words) as sonar:
        first, later, again = (sonar.ping(time_s=time_s).clean for time_s in (0.0, 3.0, 0.0))
    np.testing.assert_array_equal(first, again)
    assert (first != later).any()


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


@pytest.mark.slow
def test_memory_stays_flat_over_a_thousand_pings():
    words = (*SMALL, "scenes.width=96", "scenes.height=64")
    with Sonar("seabed", overrides=words) as sonar:
        for index in range(1100):
            pose = Pose(surge_m=0.001 * (index % 100), yaw_deg=index % 7)
            assert sonar.ping(pose, index=index).noisy.any()
            if index == 100:
                before = resident_bytes()
    assert resident_bytes() - before < 5_000_000
