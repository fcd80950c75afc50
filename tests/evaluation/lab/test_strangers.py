"""Text of a dataset is data, and names may hold what they like."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.evaluation.lab.command import read_words
from simnfnd.evaluation.lab.exports import Base, recipe, sweep_line
from simnfnd.evaluation.lab.stored_words import words_of
from simnfnd.factory.simulation.config.compose import compose, compose_points
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping, plain
from simnfnd.factory.simulation.scenes.csv_list import CsvListSettings
from tests.evaluation.lab.test_lab import SMALL

STRANGE = [
    "${oc.env:SIMNFND_SECRET}",
    "\\${oc.env:SIMNFND_SECRET}",
    "${oc.decode:${oc.env:SIMNFND_SECRET}}",
    "dives (2)/a,b=c.csv",
    "[raw] {a: b} 'x' $HOME\u00e9\n.csv",
    "!!python/object/apply:os.getcwd []",
    "null",
]


@pytest.fixture(autouse=True)
def _secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMNFND_SECRET", "hidden")


def test_text_of_a_dataset_means_itself() -> None:
    config = compose([*SMALL]).config
    text, *others = STRANGE
    scenes = CsvListSettings(file=text, intrinsics=(100.0, 100.0, 80.0, 50.0))
    name = " ".join(others)
    stranger: FactoryConfig = replace(config, scenes=scenes, sonar=replace(config.sonar, name=name))
    composition = compose(words_of(stranger))
    scenes_again: Any = composition.config.scenes
    assert scenes_again.file == text
    assert composition.config.sonar.name == name
    # And so it does in the recipe that the lab exports.
    exported = recipe(Base.of(composition.overrides, composition.values), {})
    assert "hidden" not in exported


def test_files_in_lists_mean_themselves() -> None:
    own_objects = ", ".join("{file: a.ply, class: crate}" for _ in STRANGE)
    values = plain(compose([f"scenes.own_objects=[{own_objects}]"]).config)
    for own_object, text in zip(values["scenes"]["own_objects"], STRANGE, strict=True):
        own_object["file"] = text
    again: Any = compose(words_of(from_mapping(values))).config.scenes
    assert [own_object.file for own_object in again.own_objects] == STRANGE


def test_a_recording_may_be_called_like_a_setting(tmp_path: Path) -> None:
    image = tmp_path / "gain=3 (a,b).png"
    cv2.imwrite(str(image), np.full((8, 8), 9, np.uint8))
    subject = read_words([str(image), "seed=2"])
    assert subject.real == image
    assert subject.words[-1] == "seed=2"
    assert read_words([f"scenes.file={image}"]).real is None
    # Longer than any name of a file.
    long_word = f"scenes.own_objects=[{'{file: a.ply, class: crate},' * 30}]"
    assert read_words([long_word]).words == [long_word]


def test_a_name_with_commas_is_one_point_of_a_sweep() -> None:
    path = "path (1),a=b.csv"
    composition = compose([*SMALL[:2], f"scenes.path={path}"])
    words = [*composition.overrides, *composition.pins]
    line = sweep_line(words, {}, "noise.background.density", "0.1,0.2")
    points = compose_points(shlex.split(line)[2:])
    assert [getattr(point.scenes, "path", "") for point in points] == [path] * 2
