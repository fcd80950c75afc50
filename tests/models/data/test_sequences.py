"""Windows of recordings: moving objects in them, their reference, and trainings that resume."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.schema import Axis, Column, Pair, Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.models.data.sequences import SequenceSource
from simnfnd.models.data.sources import open_data
from simnfnd.models.training.loop import TrainingLoop
from simnfnd.models.training.train import train
from tests.models.data.small_renders import SMALL, composed

SIDE = 64
FRAMES = 10
OBJECT_PX = 6
COLUMNS = (
    Column("location", "S24"), Column("scene", "S24"), Column("frame", "S24"),
    Column("variant", "i4"),
)  # fmt: skip
AXES = tuple(Axis(name, "px", np.arange(SIDE) + 0.5) for name in ("ahead", "right"))
BRIGHT = 200
NOISE = 12


def corner_of(scene: int, frame: int) -> tuple[int, int]:
    """Where the object of a recording is: it moves by 4 pixels a frame."""
    return 8 + 6 * scene, 4 + 4 * frame


def pair(scene: int, frame: int, with_static: bool = True) -> Pair:
    rows, columns = np.indices((SIDE, SIDE))
    static = (90 + 40 * np.sin(rows / (3 + scene)) * np.cos(columns / 5)).astype(np.uint8)
    clean = static.copy()
    top, left = corner_of(scene, frame)
    clean[top : top + OBJECT_PX, left : left + OBJECT_PX] = BRIGHT
    grain = np.random.default_rng([scene, frame]).normal(0, NOISE, clean.shape)
    noisy = np.clip(clean + grain, 0, 255).astype(np.uint8)
    record: dict[str, float | int | str] = {
        "location": "sea",
        "scene": str(scene),
        "frame": f"{frame:04d}",
        "variant": 0,
    }
    layers = {"static": static} if with_static else {}
    return Pair(noisy, clean, np.zeros((SIDE, SIDE), np.bool_), record, layers)


def write(folder: Path, with_static: bool = True, scenes: int = 3) -> Path:
    config: dict[str, Any] = {"scenes": {"kind": "seabed"}}
    provenance = Provenance(config, config_hash(config), "test")
    manifest = Manifest(provenance.config_hash, provenance.generator, config)
    for scene in range(scenes):
        pairs = [pair(scene, frame, with_static) for frame in range(FRAMES)]
        place = f"train/shard-{scene:05d}.h5"
        axes = AXES[0], AXES[1]
        info = write_shard(folder, place, pairs, axes, COLUMNS, provenance, DatasetSettings())
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(folder, manifest)
    return folder


@pytest.fixture(scope="module")
def swims(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("swims"))


def source_of(folder: Path, *words: str) -> SequenceSource:
    settings, _ = composed("data=sequences", f"dataset.dir='{folder}'", "data.patch=32", *words)
    source = open_data(settings).learning
    assert isinstance(source, SequenceSource)
    return source


def test_a_window_knows_moving_objects_and_its_reference_shows_them(swims):
    source = source_of(swims)
    assert len(source) == 2 * (FRAMES - 6)  # one recording validates
    for index in (0, 5):
        window = source.window(index)
        ref = source.images[index]
        scene = int(ref.recording.removeprefix("sea/"))
        for number in range(7):
            top, left = corner_of(scene, ref.start + number)
            own = np.s_[top : top + OBJECT_PX, left : left + OBJECT_PX]
            assert window.moving[number][own].all()
            assert window.moving[number].mean() < 0.06
        top, left = corner_of(scene, ref.start + 3)
        own = np.s_[top : top + OBJECT_PX, left : left + OBJECT_PX]
        np.testing.assert_allclose(window.reference[own], BRIGHT / 255, atol=1e-6)
        # Elsewhere it is the mean of all frames: the static scene with a tenth of the noise.
        rest = ~window.moving[3]
        error = (window.reference - window.static[0])[rest]
        assert error.std() < 1.3 * NOISE / 255 / np.sqrt(FRAMES)
    clean = source_of(swims, "data.reference=clean").window(0)
    np.testing.assert_array_equal(clean.reference, clean.clean[3])


def test_crops_are_drawn_by_index_and_visit_alone(swims):
    words = ("data.crops=4", "data.batch=4", "data.targets=1")
    source = source_of(swims, *words)
    again = source_of(swims, *words)
    first = source.crops(1, 3, 32)
    for crop, repeated in zip(first, again.crops(1, 3, 32), strict=True):
        assert crop.noisy.shape == (7, 32, 32)
        assert crop.corner == repeated.corner
        np.testing.assert_array_equal(crop.noisy, repeated.noisy)
        assert crop.moving[3].any()
    assert [crop.corner for crop in source.crops(1, 4, 32)] != [crop.corner for crop in first]
    none = source_of(swims, *words[:2], "data.targets=0")
    shown = [crop.moving[3].any() for visit in range(20) for crop in none.crops(1, visit, 16)]
    assert np.mean(shown) < 0.6


def test_a_sample_averages_static_pixels_and_keeps_moving_objects(swims):
    source = source_of(swims)
    sample = source.sample(2, None)
    window = source.window(2)
    moving = window.moving[3]
    assert sample.frames is not None
    assert (sample.frames[moving] == 0).all()
    np.testing.assert_allclose(sample.noisy[moving], window.noisy[3][moving], atol=1e-6)
    untouched = ~window.moving.any(axis=0)
    assert len(np.unique(sample.frames[untouched])) == 1
    mean = window.noisy.mean(axis=0)
    np.testing.assert_allclose(sample.noisy[untouched], mean[untouched], atol=1e-6)
    drawn = [source.sample(2, visit).frames for visit in range(12)]
    assert len({float(frames.max()) for frames in drawn if frames is not None}) > 3


@pytest.mark.slow
def test_a_training_on_sequences_broken_off_ends_with_the_same_bytes(swims, tmp_path, monkeypatch):
    words = ("data=sequences", f"dataset.dir='{swims}'", *SMALL, "data.crops=2", "data.reuse=2")
    train(*composed(*words, f"out='{tmp_path / 'whole'}'"))
    step = TrainingLoop.update
    calls: list[int] = []

    def breaks_down(self: TrainingLoop, *arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 4:
            raise OSError("the power went")
        return step(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingLoop, "update", breaks_down)
        with pytest.raises(OSError, match="power"):
            train(*composed(*words, f"out='{tmp_path / 'broken'}'"))
    train(*composed(*words, f"out='{tmp_path / 'broken'}'"))
    whole, broken = (
        (tmp_path / name / "weights.safetensors").read_bytes() for name in ("whole", "broken")
    )
    assert whole == broken


def test_datasets_without_windows_are_refused(tmp_path):
    for folder, word in (
        (write(tmp_path / "plain", with_static=False), "static"),
        (write(tmp_path / "single", scenes=1), "needs two"),
    ):
        with pytest.raises(FactoryError, match=word):
            source_of(folder)
