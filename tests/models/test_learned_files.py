"""What weights learned from is known by content, and said where they are judged."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from simnfnd.evaluation.judging.learned import learned_notes
from simnfnd.evaluation.judging.methods import networks_at
from simnfnd.evaluation.judging.recorded import open_input
from simnfnd.models.pretrained import shipped
from simnfnd.models.pretrained.learned_files import (
    KEY,
    LearnedFile,
    as_front_matter,
    described,
    known_as,
    learned_files,
)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "dive.npy"
    np.save(path, np.zeros((3, 40, 40), np.uint8))
    return path


def test_a_file_is_known_by_its_content(recording: Path, tmp_path: Path) -> None:
    learned = described([recording, recording, tmp_path / "absent"])
    assert [entry.file for entry in learned] == ["dive.npy"]
    copy = shutil.copy(recording, tmp_path / "other.npy")
    assert known_as(Path(copy), learned) == "dive.npy"
    changed = bytearray(recording.read_bytes())
    changed[-1] ^= 1
    recording.write_bytes(changed)
    assert known_as(recording, learned) is None


def test_cards_and_headers_say_what_was_learned_from(recording: Path, tmp_path: Path) -> None:
    weights = tmp_path / "own.safetensors"
    (first,) = described([recording])
    second = LearnedFile("second: #1.avi", 7, "ab" * 32)
    header = {"training": {KEY: [first._asdict()]}}
    save_file(
        {"w": np.zeros(1, np.float32)}, weights, {"simnfnd": json.dumps(header, sort_keys=True)}
    )
    assert learned_files(weights) == [first]
    card = f"---\nlicense: apache-2.0\n{as_front_matter([first, second])}---\n\n# own\n"
    weights.with_suffix(".md").write_text(card)
    assert learned_files(weights) == [first, second]


@pytest.mark.parametrize(
    "front", ["", ": [", "learned_from: 3", "learned_from: [{file: a}, 7, {a: b, c: d, e: f}]"]
)
def test_damaged_cards_say_nothing(front: str, tmp_path: Path) -> None:
    weights = tmp_path / "own.safetensors"
    weights.with_suffix(".md").write_text(f"---\n{front}\n---\n")
    assert learned_files(weights) == []


def test_weights_that_ship_learned_from_no_recording() -> None:
    for name, weights in shipped().items():
        assert f"\n{KEY}: []\n" in weights.with_suffix(".md").read_text(encoding="utf-8"), name
        assert learned_files(weights) == [], name


def test_judging_on_training_files_is_said(recording: Path, tmp_path: Path) -> None:
    weights = tmp_path / "own.safetensors"
    header = {"training": {KEY: [entry._asdict() for entry in described([recording])]}}
    save_file(
        {"w": np.zeros(1, np.float32)}, weights, {"simnfnd": json.dumps(header, sort_keys=True)}
    )
    stretches, _ = open_input(recording)
    own_network, shipped_network = networks_at([str(weights), "simnfnd"])
    (note,) = learned_notes(stretches, [own_network, shipped_network])
    assert note.startswith("warning: own learned from dive.npy")
    assert learned_notes(stretches, [shipped_network]) == []
