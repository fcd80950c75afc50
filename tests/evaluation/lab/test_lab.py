"""`simnfnd lab`: its images and exports against those of `make`, its answers, its page."""

from __future__ import annotations

import base64
import json
import re
import shlex
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from simnfnd import make_dataset
from simnfnd.evaluation.lab import server
from simnfnd.evaluation.lab.charts import charts_of
from simnfnd.evaluation.lab.command import read_words
from simnfnd.evaluation.lab.parameters import parameters_of, sentences_of, slider_ends
from simnfnd.evaluation.lab.server import LabServer
from simnfnd.evaluation.lab.session import Session
from simnfnd.evaluation.lab.stored_words import words_of_dataset
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.pair_dataset import PairDataset
from simnfnd.factory.simulation.config.compose import compose_config, compose_points
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.imaging.settings import CoherentSettings
from simnfnd.factory.simulation.noise.registry import EFFECTS
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from tests.evaluation.browser import CHROMIUM, kept_by_page

SMALL = (
    "render=analytic", "scenes.locations=1", "scenes.frames_per_location=2", "scenes.width=160",
    "scenes.height=100", "sonar.beams=48", "sonar.range_bins=64", "sonar.image.width_px=64",
    "sonar.image.height_px=64",
)  # fmt: skip
COHERENT = ("experiment=physical", *SMALL)
CHANGES: dict[str, Any] = {
    "noise.receiver.level_db": 17.5,
    "noise.texture.shape": {"uniform": [2, 3.5]},
    "noise.spokes.count": {"uniform": [1, 3]},
    "noise.receiver.grain": "beam",
    "noise.bottom_multipath.enabled": True,
    "noise.bottom_multipath.altitude_m": 1,
    "sonar.array.beamwidth_deg": 1.25,
    "sonar.transfer.full_scale_db": None,
    "seed": 3,
}


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(COHERENT)


@pytest.fixture(scope="module")
def dataset(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the exported command makes, two pairs of each frame."""
    folder = tmp_path_factory.mktemp("made")
    words = shlex.split(session.exports(CHANGES).command)
    assert words[:2] == ["simnfnd", "make"]
    more = ("frames.variants=2", "scheduler=serial", f"cache.dir={folder / 'cache'}")
    make_dataset(*words[2:], *more, out=folder / "dataset")
    return folder / "dataset"


@pytest.mark.slow
def test_the_exported_command_makes_the_images_of_the_lab(session: Session, dataset: Path) -> None:
    pairs = PairDataset(dataset, "all", scaled=False)
    for number in (0, 1):
        for pair in session.pairs(CHANGES, number, (0, 1)):
            frame = session.frames[number].frame
            variant = pair.record["variant"]
            row = next(
                index
                for index, row in enumerate(pairs.meta())
                if (row["frame"].decode(), row["variant"]) == (frame, variant)
            )
            assert pair.noisy.tobytes() == pairs[row]["noisy"].tobytes()
            assert pair.clean.tobytes() == pairs[row]["clean"].tobytes()


@pytest.mark.slow
def test_a_dataset_is_where_the_lab_goes_on(session: Session, dataset: Path) -> None:
    again = Session(words_of_dataset(dataset))
    more = {"noise.volume.strength_db": -40}
    (expected,) = session.pairs({**CHANGES, **more}, 1, (0,))
    (pair,) = again.pairs(more, 1, (0,))
    assert pair.noisy.tobytes() == expected.noisy.tobytes()
    assert compose_config(again.words).noise == session.configured(CHANGES).noise


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "changes"),
    [
        (COHERENT, CHANGES),
        (SMALL, {"noise.background.density": {"choice": [0.1, 0.2]}, "resample.rate": 0.4}),
        (("experiment=fish",), {"noise.path_speckle.looks": 2, "noise.texture.enabled": False}),
    ],
)  # fmt: skip
def test_the_recipe_and_the_sweep_mean_the_same(
    words: tuple[str, ...], changes: dict[str, Any], tmp_path: Path
) -> None:
    session = Session(words)
    sweep = ("sonar.transfer.percentile", "70,80.5")
    exports = session.exports(changes, sweep)
    file = tmp_path / "experiment" / "mine.yaml"
    file.parent.mkdir()
    file.write_text(exports.recipe)
    wanted = session.configured(changes)
    assert _images(compose_config([f"--config-dir={tmp_path}", "experiment=mine"])) == _images(
        wanted
    )
    assert _images(compose_config(shlex.split(exports.command)[2:])) == _images(wanted)
    points = compose_points(shlex.split(exports.sweep)[2:])
    each = [session.configured({**changes, sweep[0]: value}) for value in (70, 80.5)]
    assert [_images(point) for point in points] == [_images(config) for config in each]


def _images(config: Any) -> dict[str, Any]:
    """What decides the bytes of images."""
    return {key: value for key, value in identity(config).items() if key != "dataset"}


def test_changes_without_effect_stay_out_of_exports(session: Session) -> None:
    changes = {"noise.volume.enabled": False, "noise.volume.strength_db": -40.0}
    command = session.exports(changes).command
    assert "noise.volume.enabled=false" in command
    assert "strength_db" not in command


def test_every_parameter_has_a_sentence_a_unit_and_a_range() -> None:
    classes = [effect.settings for effect in EFFECTS.values()]
    for settings in classes:
        names = {item.name for item in fields(settings)} - {"enabled"}
        assert names == set(sentences_of(settings)) - {"enabled"}, settings
    parameters = parameters_of(compose_config(["experiment=physical", "sonar=aris_1800_hf"]))
    keys = [parameter.key for parameter in parameters]
    assert len(keys) == len(set(keys))
    for parameter in parameters:
        assert parameter.sentence, parameter.key
        assert parameter.low < parameter.high
        assert 0 < parameter.step <= parameter.high - parameter.low
    units = {parameter.key: parameter.unit for parameter in parameters}
    assert units["noise.ring_down.decay_db_per_m"] == "dB/m"
    assert units["sonar.frequency_khz"] == "kHz"
    assert units["sonar.image.width_px"] == "pixels"
    assert units["sonar.beams"] == ""
    assert "beams" in sentences_of(SonarSettings)
    assert "standing" in sentences_of(CoherentSettings)


@pytest.mark.parametrize(
    ("numbers", "lowest", "highest", "unit", "expected"),
    [
        ((-70, -52), -np.inf, np.inf, "dB", (-90, -32)),
        ((0.1, 0.2), 0, 1, "1", (0, 0.6)),
        ((0.5,), 0, 1, "1", (0, 1)),
        ((-2, 1), -np.inf, np.inf, "m", (-6, 6)),
        ((), -90, 90, "degrees", (-10, 10)),
    ],
)
def test_sliders_reach_around_their_value(
    numbers: tuple[float, ...],
    lowest: float,
    highest: float,
    unit: str,
    expected: tuple[float, float],
) -> None:
    assert slider_ends(numbers, lowest, highest, unit) == expected


def test_charts_tell_grains_apart() -> None:
    rng = np.random.default_rng(1)
    fine = rng.integers(1, 256, (96, 128)).astype(np.uint8)
    coarse = np.repeat(np.repeat(fine[:24, :32], 4, axis=0), 4, axis=1)
    fine_charts = charts_of(fine)
    coarse_charts = charts_of(coarse)
    assert sum(fine_charts.histogram) == pytest.approx(1, abs=1e-3)
    assert fine_charts.grain_rows[1] < 0.2 < 0.6 < coarse_charts.grain_rows[1]
    assert np.ptp(fine_charts.spectrum_db) < 6 < np.ptp(coarse_charts.spectrum_db)
    assert charts_of(np.zeros((64, 64), np.uint8)).grain_rows == []
    assert charts_of(fine[:8, :8]).spectrum_db == []


# --- words ---


def test_words_are_sorted_by_what_they_name(tmp_path: Path) -> None:
    image = tmp_path / "real.png"
    cv2.imwrite(str(image), np.full((8, 8), 9, np.uint8))
    assert read_words([]).words == ["experiment=physical"]
    assert read_words(["seed=2"]).words == ["seed=2"]
    subject = read_words(["didson_hf", str(image), "a/b/c", "seed=2"])
    assert subject.words == ["experiment=physical", "sonar=didson_hf", "seed=2"]
    assert (subject.real, subject.frame) == (image, "a/b/c")
    words = read_words(["didson_hf", "experiment=aris_raw"]).words
    assert words == ["sonar=didson_hf", "experiment=aris_raw"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["didson_hff"], "didson_hf"),
        (["no/such.png"], "no/such.png"),
        (["didson_hf", "didson_lf"], "didson_lf"),
    ],
)
def test_a_wrong_word_is_one_line(words: list[str], named: str) -> None:
    with pytest.raises(FactoryError, match=re.escape(named)) as caught:
        read_words(words)
    assert "\n" not in str(caught.value)


def test_a_frame_that_is_not_there_is_named(session: Session) -> None:
    with pytest.raises(FactoryError, match="reef/reef/7"):
        session.frame("reef/reef/7")
    assert session.frame(session.frames[1].name) == 1


# --- answers ---


@contextmanager
def served(session: Session, real: Path | None = None) -> Iterator[str]:
    with LabServer(session, real) as lab:
        threading.Thread(target=lab.serve_forever, daemon=True).start()
        try:
            yield lab.url
        finally:
            lab.shutdown()


def answer(url: str, path: str, request: Any) -> Any:
    with urlopen(f"{url}{path}?{quote(json.dumps(request))}", timeout=90) as response:
        return json.loads(response.read())


def grey(image: dict[str, Any]) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(image["grey"]), np.uint8)
    return values.reshape(image["height"], image["width"])


def test_answers_hold_the_images_beside_a_real_one(session: Session, tmp_path: Path) -> None:
    image = tmp_path / "real.png"
    cv2.imwrite(str(image), np.arange(64 * 80, dtype=np.uint8).reshape(64, 80))
    changes = {"noise.receiver.level_db": 30}
    first, *_ = expected = session.pairs(changes, 0, tuple(range(6)))
    with served(session, image) as url:
        about = answer(url, "about.json", {})
        assert (about["real"], about["real_frames"]) == ("real.png", 1)
        shown = answer(url, "images.json", {"changes": changes, "right": "real"})
        np.testing.assert_array_equal(grey(shown["left"]), first.noisy)
        np.testing.assert_array_equal(grey(shown["right"]), cv2.imread(str(image), 0))
        assert shown["drawn"]["noise.receiver.level_db"] == 30
        assert "noise.bottom_multipath.loss_db" in shown["inert"]
        assert shown["exports"]["command"].endswith("noise.receiver.level_db=30")
        clean = answer(url, "images.json", {"changes": changes})["right"]
        np.testing.assert_array_equal(grey(clean), first.clean)
        unchanged = answer(url, "images.json", {"changes": changes, "right": "unchanged"})["right"]
        np.testing.assert_array_equal(grey(unchanged), session.pairs({}, 0, (0,))[0].noisy)
        draws = answer(url, "draws.json", {"changes": changes})["images"]
        for drawn, pair in zip(draws, expected, strict=True):
            np.testing.assert_array_equal(grey(drawn), pair.noisy)


@pytest.mark.parametrize(
    ("request_values", "named"),
    [
        ({"changes": {"scenes.root": "/"}}, "scenes.root"),
        ({"changes": {"noise.texture.shape": "many"}}, "noise.texture.shape"),
        ({"changes": {"sonar.beams": -1}}, "sonar.beams"),
        ({"changes": {"sonar.range.auto": False, "sonar.range.min_m": 29}}, "sonar.range"),
        ({"frame": 2}, "request.frame"),
        ({"right": "real"}, "request.real"),
        ({"right": "nothing"}, "request.right"),
        ({"more": 1}, "request.more"),
        ([], "request"),
        ({"sweep": ["noise.texture.shape", "1,"]}, "noise.texture.shape"),
    ],
)
def test_bad_requests_get_one_line(session: Session, request_values: Any, named: str) -> None:
    with served(session) as url, pytest.raises(HTTPError) as caught:
        answer(url, "images.json", request_values)
    assert caught.value.code == 500
    line = caught.value.read().decode()
    assert named in line
    assert "\n" not in line


def test_a_defect_reaches_the_page_and_blocks_nothing(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    with served(session) as url:
        with monkeypatch.context() as patch:
            patch.setattr(Session, "pairs", lambda *_: 1 / 0)
            with pytest.raises(HTTPError) as caught:
                answer(url, "images.json", {})
        assert caught.value.code == 500
        assert "ZeroDivisionError" in caught.value.read().decode()
        assert answer(url, "about.json", {})["frame"] == 0


# --- the page ---

# Moves a slider, marks a parameter for a sweep, and sends what was shown before and after.
_SCRIPT = """
const greyOf = canvas => btoa(String.fromCharCode(...canvas.getContext("2d")
  .getImageData(0, 0, canvas.width, canvas.height).data.filter((_, index) => index % 4 === 0)));
const kept = {};
const whenAnswered = (count, then) => setTimeout(
  () => (answers >= count && !isBusy ? then() : whenAnswered(count, then)), 20);
whenAnswered(1, () => {
  kept.before = greyOf(at("left"));
  const slider = at("control-noise.receiver.level_db");
  slider.value = 31;
  slider.dispatchEvent(new Event("input"));
  document.querySelector("[aria-label='sweep sonar.transfer.percentile']").click();
  whenAnswered(2, () => {
    kept.after = greyOf(at("left"));
    for (const name of ["command", "sweep", "recipe"]) kept[name] = at(name).value;
    kept.unnamed = document.querySelectorAll(
      "#controls input:not([aria-label]):not([id]), #controls select:not([id])").length;
    fetch(`kept?${encodeURIComponent(JSON.stringify(kept))}`);
  });
});
"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_a_slider_moves_the_image(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = shutil.copytree(server._FOLDER, tmp_path / "page")
    with (folder / "page.js").open("a") as file:
        file.write(_SCRIPT)
    monkeypatch.setattr(server, "_FOLDER", folder)
    with LabServer(session) as lab:
        kept = kept_by_page(lab, tmp_path, monkeypatch)
    before, after = (base64.b64decode(kept[name]) for name in ("before", "after"))
    # The lower end of the range, which takes the upper one along.
    changes = {"noise.receiver.level_db": {"uniform": [31, 31]}}
    assert before == session.pairs({}, 0, (0,))[0].noisy.tobytes()
    assert after == session.pairs(changes, 0, (0,))[0].noisy.tobytes()
    assert after != before
    exports = session.exports(changes, ("sonar.transfer.percentile", "0.5,50.25,100"))
    assert kept["unnamed"] == 0
    assert {name: kept[name] for name in exports._fields} == exports._asdict()
