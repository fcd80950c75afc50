"""Recordings of a dataset, and their tracks in the formats of trackers."""

from __future__ import annotations

import configparser
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.pair_dataset import PairDataset
from simnfnd.factory.dataset.schema import Column, Pair, Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.factory.production.export import export
from tests.factory.production.export.export_dataset import AXES, SHAPE

COLUMNS = (
    Column("location", "S24"), Column("scene", "S24"), Column("frame", "S24"),
    Column("variant", "i4"), Column("time_s", "f8"), Column("tracks", "S2000"),
)  # fmt: skip
CONFIG: dict[str, Any] = {"classes": ["Whale", "Fish", "Ray"], "scenes": {"kind": "seabed"}}
FRAMES = (0, 1, 2, 3, 5, 6, 7, 8)  # frame 4 failed


def track(number: int, frame: int) -> dict[str, Any]:
    box = [frame, 2 * number, 5, 4] if frame != 2 else None
    if frame == 3:
        box = [frame, 2 * number, 3, 9]  # too narrow
    return {
        "id": number,
        "class": ("Fish", "Ray")[number - 1],
        "box": box,
        "occluded": 0.25,
        "range_m": 3.0,
    }


def pair(scene: str, frame: int, tracks: str | None = None) -> Pair:
    rng = np.random.default_rng([frame, len(scene)])
    noisy, clean, static = rng.integers(0, 256, (3, *SHAPE), dtype=np.uint8)
    text = json.dumps([track(1, frame), track(2, frame)]) if tracks is None else tracks
    record: dict[str, float | int | str] = {
        "location": "sea", "scene": scene, "frame": f"{frame:04d}", "variant": 0,
        "time_s": frame / 8, "tracks": text,
    }  # fmt: skip
    return Pair(noisy, clean, np.zeros(SHAPE, np.bool_), record, {"static": static})


def dataset(folder: Path, scenes: dict[str, list[Pair]]) -> Path:
    provenance = Provenance(CONFIG, config_hash(CONFIG), "test")
    manifest = Manifest(provenance.config_hash, provenance.generator, CONFIG)
    for number, (split, pairs) in enumerate(scenes.items()):
        place = f"{split}/shard-{number:05d}.h5"
        info = write_shard(folder, place, pairs, AXES, COLUMNS, provenance, DatasetSettings())
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(folder, manifest)
    return folder


@pytest.fixture(scope="module")
def swims(tmp_path_factory: pytest.TempPathFactory) -> Path:
    # The frames of two recordings lie mixed in one shard.
    mixed = [pair(scene, frame) for frame in FRAMES[::-1] for scene in ("one", "two")]
    test = [pair("three", frame) for frame in FRAMES]
    return dataset(tmp_path_factory.mktemp("swims"), {"train": mixed, "test": test})


def test_a_sequence_has_its_frames_in_order(swims):
    with PairDataset(swims, "train", layers=("noisy", "clean", "static", "shadow")) as pairs:
        assert pairs.recordings.names == ("sea/one", "sea/two")
        sequence = pairs.sequence("sea/two")
        assert sequence.static is not None
        assert sequence.noisy.shape == sequence.clean.shape == (len(FRAMES), *SHAPE)
        assert sequence.time_s.tolist() == [frame / 8 for frame in FRAMES]
        for number, frame in enumerate(FRAMES):
            expected_pair = pair("two", frame)
            np.testing.assert_array_equal(sequence.noisy[number], expected_pair.noisy)
            np.testing.assert_array_equal(sequence.static[number], expected_pair.layers["static"])
            assert sequence.tracks[number][1]["id"] == 2
        assert set(sequence.truth) == {"shadow"}
        with pytest.raises(FactoryError, match="sea/four"):
            pairs.sequence("sea/four")
    with (
        PairDataset(swims, "all", layers=("noisy",)) as pairs,
        pytest.raises(FactoryError, match="clean"),
    ):
        pairs.sequence("sea/one")


def test_windows_stay_in_a_recording_and_cross_no_gap(swims):
    with PairDataset(swims, "all") as pairs:
        actual = [(window.recording, window.frames) for window in pairs.windows(3)]
        assert len(actual) == 3 * 4  # 0-2, 1-3, 5-7 and 6-8 of each
        assert ("sea/one", ("0001", "0002", "0003")) in actual
        assert all("0004" not in frames for _, frames in actual)
        assert [len(window) for window in pairs.windows(7)] == []
        assert len(list(pairs.windows(2, step=3))) == 3 * 2


def mot_challenge_accuracy(gt_path: Path, frame_count: int) -> float:
    """MOTA of the truth itself, by the rules that TrackEval has for MOTChallenge at its defaults.

    Refuses what TrackEval refuses: classes that MOT17 does not have, frames beyond the sequence,
    and ids that come twice in a frame.  Class 1 alone is judged, results having no class.
    """
    lines = np.loadtxt(gt_path, delimiter=",", ndmin=2)
    assert set(lines[:, 7]) <= set(range(1, 14))
    assert 1 <= lines[:, 0].min() <= lines[:, 0].max() <= frame_count
    ids_in_frames = lines[:, :2]
    assert len(np.unique(ids_in_frames, axis=0)) == len(lines)
    is_judged = (lines[:, 6] != 0) & (lines[:, 7] == 1)
    false_positives = len(lines) - is_judged.sum()
    return float(1 - false_positives / is_judged.sum())


BOXES = 2 * (len(FRAMES) - 2)  # of a recording: two frames have none that is large


def test_mot_has_a_line_for_each_box(swims, tmp_path):
    said = export(swims, "mot", tmp_path / "out")
    assert said.startswith(f"3 recordings, {3 * len(FRAMES)} frames, {3 * BOXES} boxes; 6 ")
    place = tmp_path / "out/train/sea-two"
    lines = np.loadtxt(place / "gt/gt.txt", delimiter=",")
    assert lines.shape == (BOXES, 9)
    assert lines[0].tolist() == [1, 1, 1, 3, 5, 4, 1, 1, 0.75]  # from 1, of box 0, 2, 5, 4
    assert not {3, 4} & set(lines[:, 0])  # no echo, and a narrow one
    assert (place / "gt/classes.csv").read_text() == "id,class\n1,Fish\n2,Ray\n"
    # Datasets of earlier versions state no length and no axis.
    truth = (place / "gt/tracks.csv").read_text().splitlines()
    assert truth[0] == "frame,id,range_m,bearing_deg,length_m,body_bearing_deg"
    assert len(truth) == BOXES + 1
    assert truth[1].endswith(",,")
    assert mot_challenge_accuracy(place / "gt/gt.txt", len(FRAMES)) == 1
    info = configparser.ConfigParser()
    info.read(place / "seqinfo.ini")
    assert info["Sequence"]["seqlength"] == str(len(FRAMES))
    assert info["Sequence"].getint("framerate") == 8  # also where a frame failed
    assert info["Sequence"].getfloat("exactframerate") == 8
    image = cv2.imread(str(place / "img1/000001.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, pair("two", 0).noisy)


def test_mot_numbers_chosen_classes(swims, tmp_path):
    export(swims, "mot", tmp_path / "out", class_names=("Ray", "Whale"), min_side_px=1)
    lines = np.loadtxt(tmp_path / "out/train/sea-two/gt/gt.txt", delimiter=",")
    assert {(line[1], line[7]) for line in lines} == {(2, 1)}
    assert len(lines) == len(FRAMES) - 1  # narrow ones, too


def test_pycocotools_judges_the_boxes_of_coco_video(swims, tmp_path):
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    export(swims, "coco_video", tmp_path / "out", "train")
    path = tmp_path / "out/annotations/instances_train.json"
    assert {"info", "images", "annotations", "licenses", "categories"} <= set(
        json.loads(path.read_text())
    )
    truth = COCO(str(path))
    results = [{**annotation, "score": 1.0} for annotation in truth.dataset["annotations"]]
    judge = COCOeval(truth, truth.loadRes(results), "bbox")
    judge.evaluate()
    judge.accumulate()
    judge.summarize()
    assert judge.stats[0] == 1.0
    names = [category["name"] for category in truth.loadCats(truth.getCatIds())]
    assert names == ["Fish", "Ray"]


def test_coco_video_numbers_tracks_and_recordings(swims, tmp_path):
    export(swims, "coco_video", tmp_path / "out", "train")
    export(swims, "coco_video", tmp_path / "both")
    ids: dict[str, set[int]] = {"images": set(), "annotations": set(), "videos": set()}
    for split in ("train", "test"):
        path = tmp_path / f"both/annotations/instances_{split}.json"
        for kind, known in ids.items():
            own_ids = {entry["id"] for entry in json.loads(path.read_text())[kind]}
            assert own_ids
            assert not own_ids & known
            known |= own_ids
    document = json.loads((tmp_path / "out/annotations/instances_train.json").read_text())
    assert [video["name"] for video in document["videos"]] == ["sea-one", "sea-two"]
    of_videos = {image["id"]: image["video_id"] for image in document["images"]}
    tracks: dict[int, set[int]] = {}
    for annotation in document["annotations"]:
        assert annotation["video_id"] == of_videos[annotation["image_id"]]
        tracks.setdefault(annotation["track_id"], set()).add(annotation["video_id"])
    assert len(tracks) == 4
    assert all(len(videos) == 1 for videos in tracks.values())
    for image in document["images"]:
        assert (tmp_path / "out/images/train" / image["file_name"]).is_file()


@pytest.mark.parametrize(
    ("tracks", "word"),
    [
        ("{", "damaged"),
        ('[{"id": 1}]', "damaged"),
        ('[{"id": 1, "class": "Fish", "box": [1, 2], "occluded": 0}]', "damaged"),
        ('[{"id": 1, "class": "../../Whale", "box": [1, 2, 3, 4], "occluded": 0}]', "Whale"),
    ],
)
def test_odd_tracks_are_refused(tmp_path, tracks, word):
    odd = dataset(tmp_path / "odd", {"train": [pair("one", 0, tracks)]})
    with pytest.raises(FactoryError, match=word):
        export(odd, "mot", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_recordings_name_leads_nowhere_else(tmp_path):
    scenes = ("../../up", "dive 1", "dive,1")
    odd = dataset(tmp_path / "odd", {"train": [pair(scene, 0) for scene in scenes]})
    for to, place in (("mot", "train"), ("coco_video", "images/train")):
        export(odd, to, tmp_path / to / "deep/deeper")
        folders = [path.name for path in (tmp_path / to / "deep/deeper" / place).iterdir()]
        # Names that become the same are numbered.
        assert sorted(folders) == ["sea-..-..-up", "sea-dive-1", "sea-dive-1-2"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["coco_video", "mot", "odd"]


def test_frames_without_times_are_in_the_order_of_their_numbers(tmp_path):
    pairs = []
    for number in (10, 2, 1):
        plain = pair("one", number)
        record = {**plain.record, "frame": str(number), "time_s": float("nan")}
        pairs.append(replace(plain, record=record))
    with PairDataset(dataset(tmp_path, {"train": pairs})) as opened:
        assert opened.sequence("sea/one").frames == ("1", "2", "10")


def test_a_dataset_without_tracks_is_named(tmp_path):
    from tests.factory.production.export.export_dataset import write

    source = write(tmp_path / "plain")
    with pytest.raises(FactoryError, match="has no tracks"):
        export(source, "coco_video", tmp_path / "out")
