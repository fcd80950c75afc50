"""`simnfnd denoise` on bags of ROS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.models.denoise import options
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.rosbag import IMAGE, RosBag
from tests.models.denoise.untrained import Halving, main, results_in
from tests.models.recordings.bag_files import content, image, sonar, write_bag
from tests.models.recordings.recording_files import pings


def test_bags_become_bags(tmp_path: Path, halving: Halving) -> None:
    folder = tmp_path / "in"
    (folder / "deep").mkdir(parents=True)
    samples = pings(3, 20, 16)
    for name, version in (("a.bag", 1), ("deep/b", 2), ("c.mcap", 2)):
        store = typestore(version)
        messages = [sonar(store, number, ping) for number, ping in enumerate(samples)]
        write_bag(folder / name, {"/sonar": (SONAR, messages)})
    out = tmp_path / "out"
    assert main([str(folder), "--out", str(out), "--compare"]) == 0
    for name in ("a.bag", "deep/b", "c.mcap"):
        before, after = (
            [message[:3] for message in content(place / name)] for place in (folder, out)
        )
        assert before == after
        with open_recording(out / name) as bag:
            for old, new in zip(samples, bag, strict=True):
                assert np.abs(new.samples - old / 2).max() <= 0.5
    assert len(halving.geometries) == 9
    geometry = halving.geometries[0]
    assert geometry is not None
    assert (geometry.layout, geometry.range_bins, len(geometry.beam_azimuths_rad)) == (
        "polar",
        20,
        16,
    )
    assert (out / "compare" / "deep" / "b.png").is_file()


def test_bags_that_cannot_be_denoised_are_skipped(
    tmp_path: Path, halving: Halving, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    store = typestore(1)
    write_bag(folder / "a.bag", {"/sonar": (SONAR, [sonar(store, 0, pings(1, 12, 8)[0])])})
    loud = image(store, 0, np.full((9, 9), 3, np.float32), "32FC1")
    write_bag(folder / "loud.bag", {"/p": (IMAGE, [loud])})
    (folder / "short.bag").write_bytes((folder / "a.bag").read_bytes()[:-200])
    write_bag(folder / "there", {"/p": (IMAGE, [image(typestore(2), 0, pings(1, 9, 9)[0])])})
    out = tmp_path / "out"
    (out / "there").mkdir(parents=True)
    assert main([str(folder), "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "loud.bag: frame 0: floats must be grey values from 0 to 1" in said
    assert "short.bag: cannot be read" in said
    assert "rosbag reindex" in said
    assert "there: exists already; remove it, or give another --out" in said
    assert results_in(out) == ["a.bag", "there"]


def test_frames_of_one_topic_are_fused(
    tmp_path: Path, halving: Halving, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each of several topics is a sequence of its own."""
    store = typestore(1)
    still = [sonar(store, number, pings(1, 40, 32)[0]) for number in range(3)]
    write_bag(tmp_path / "a.bag", {"/a": (SONAR, still), "/b": (SONAR, still)})
    words = [str(tmp_path / "a.bag"), "--out", str(tmp_path / "out"), "--frames", "3"]
    assert options.main(words) == 0
    assert "kinds of frames: 2, each denoised among its like: /a (3" in capsys.readouterr().out
    assert options.main([*words, "--topic", "/b"]) == 0
    assert "in time: " in capsys.readouterr().out
    with RosBag(tmp_path / "out/a.bag", ["/a"]) as bag:
        assert (bag[1].samples == pings(1, 40, 32)[0]).all()


def test_float_pings_have_any_scale(
    tmp_path: Path, halving: Halving, capsys: pytest.CaptureFixture[str]
) -> None:
    """Decibels are refused with the option that takes them; what lies outside stays outside."""
    store = typestore(2)
    decibels = np.linspace(-70, 5, 3 * 12 * 8, dtype=np.float32).reshape(3, 12, 8)
    messages = [sonar(store, number, ping) for number, ping in enumerate(decibels)]
    path = write_bag(tmp_path / "in" / "a.mcap", {"/sonar": (SONAR, messages)})
    words = [str(path), "--out", str(tmp_path / "out")]
    with pytest.raises(FactoryError, match="--levels"):
        main(words)
    assert main([*words, "--levels", "-60", "0"]) == 0
    with RosBag(tmp_path / "out/a.mcap") as bag:
        denoised = np.stack([frame.samples for frame in bag])
    inside = np.clip(decibels, -60, 0)
    np.testing.assert_allclose(denoised, (inside - 60) / 2 + decibels - inside, atol=1e-3)
    with pytest.raises(FactoryError, match="--levels 0 -60"):
        main([*words, "--levels", "0", "-60"])
