"""Text of a dataset is data, names may hold what they like, and every error reaches the page."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError

import cv2
import numpy as np
import pytest

from simnfnd.evaluation.lab.command import read_words
from simnfnd.evaluation.lab.exports import Base, recipe
from simnfnd.evaluation.lab.session import Session
from simnfnd.evaluation.lab.stored_words import words_of
from simnfnd.factory.production.cli.compose import compose, compose_points
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping, plain
from simnfnd.factory.simulation.scenes.csv_list import CsvListSettings
from tests.evaluation.lab.test_lab import SMALL, answer, served

STRANGE = [
    "${oc.env:SIMNFND_SECRET}",
    "\\${oc.env:SIMNFND_SECRET}",
    "dives (2)/a,b=c.csv",
    "[raw] {a: b} 'x' $HOME.csv",
    "null",
]


@pytest.mark.parametrize("text", STRANGE)
def test_text_of_a_dataset_means_itself(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMNFND_SECRET", "hidden")
    config = compose([*SMALL]).config
    scenes = CsvListSettings(file=text, intrinsics=(100.0, 100.0, 80.0, 50.0))
    stranger: FactoryConfig = replace(config, scenes=scenes, sonar=replace(config.sonar, name=text))
    words = words_of(stranger)
    composition = compose(words)
    scenes_again: Any = composition.config.scenes
    assert scenes_again.file == text
    assert composition.config.sonar.name == text
    # And so it does in the recipe that the lab exports.
    exported = recipe(Base.of(composition.overrides, composition.values), {})
    assert "hidden" not in exported


def test_files_in_lists_mean_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMNFND_SECRET", "hidden")
    config = compose(
        ["scenes.own_objects=[{file: meshes/a.ply, class: crate, per_place: [1, 1]}]"]
    ).config
    values = plain(config)
    name = "meshes/${oc.env:SIMNFND_SECRET} (1), b=c.ply"
    values["scenes"]["own_objects"][0]["file"] = name
    again: Any = compose(words_of(from_mapping(values))).config.scenes
    assert again.own_objects[0].file == name


def test_a_recording_may_be_called_like_a_setting(tmp_path: Path) -> None:
    image = tmp_path / "gain=3 (a,b).png"
    cv2.imwrite(str(image), np.full((8, 8), 9, np.uint8))
    subject = read_words([str(image), "seed=2"])
    assert subject.real == image
    assert subject.words[-1] == "seed=2"
    assert read_words([f"scenes.file={image}"]).real is None


def test_a_name_with_commas_is_one_point_of_a_sweep(tmp_path: Path) -> None:
    path = tmp_path / "path (1),a=b.csv"
    path.write_text("time_s,surge_m\n0,0\n0.1,0.05\n")
    session = Session([*SMALL[:1], "scenes.locations=1", *SMALL[3:], f"scenes.path={path}"])
    line = session.exports({}, ("noise.background.density", "0.1,0.2")).sweep
    points = compose_points(shlex.split(line)[2:])
    assert [getattr(point.scenes, "path", "") for point in points] == [str(path)] * 2


def test_a_defect_reaches_the_page_and_blocks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(SMALL)
    with served(session) as url:
        with monkeypatch.context() as patch:
            patch.setattr(Session, "pairs", lambda *_: 1 / 0)
            with pytest.raises(HTTPError) as caught:
                answer(url, "images.json", {})
        assert caught.value.code == 500
        assert "ZeroDivisionError" in caught.value.read().decode()
        assert answer(url, "about.json", {})["frame"] == 0
