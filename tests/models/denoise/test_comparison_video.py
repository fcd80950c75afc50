"""`--compare FILE.mp4`: one video of noisy and denoised side by side that every player shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.denoise.comparison_video import comparison_video
from simnfnd.models.denoise.writers import CAPTION_PX
from tests.models.denoise.untrained import main, results_in
from tests.models.recordings.recording_files import pings, write_aris


def decoded(path: Path) -> tuple[Any, list[Array], list[float]]:
    """The codec, the images and when each is shown, seconds."""
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
        codec = container.streams.video[0].codec_context
        return (
            codec,
            [frame.to_ndarray(format="gray") for frame in frames],
            [float(frame.time) for frame in frames],
        )


@pytest.mark.usefixtures("halving")
def test_a_recording_becomes_a_video_of_both(tmp_path: Path) -> None:
    write_aris(tmp_path / "a.aris", pings(4, 40, 48))
    out = tmp_path / "out"
    talk = tmp_path / "talk.mp4"
    assert main([str(tmp_path / "a.aris"), "--out", str(out), "--compare", str(talk)]) == 0
    assert results_in(out) == ["a.aris"], "no sheet beside it"
    codec, images, times_s = decoded(talk)
    assert (codec.name, codec.pix_fmt) == ("h264", "yuv420p")
    assert len(images) == 4
    np.testing.assert_allclose(np.diff(times_s), 0.1, atol=0.02)
    height, width = images[0].shape
    assert height % 2 == width % 2 == 0
    noisy = images[0][CAPTION_PX:, : width // 2].astype(float)
    denoised = images[0][CAPTION_PX:, width // 2 :].astype(float)
    assert denoised.mean() == pytest.approx(noisy.mean() / 2, rel=0.15)


@pytest.mark.usefixtures("halving")
@pytest.mark.parametrize("place", ["before", "after"])
def test_an_input_after_the_word_is_an_input(tmp_path: Path, place: str) -> None:
    image = np.full((40, 40), 90, np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    words = ["--compare", str(tmp_path / "a.png")]
    words = words if place == "after" else words[::-1]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "compare" / "a.png").is_file()


def test_images_of_any_size_and_a_pause_fit(tmp_path: Path) -> None:
    shown = [(50, 60, 0.0), (50, 60, 0.25), (30, 200, 900.0), (2000, 3000, 900.1)]
    for name in ("one.mp4", "two.mp4"):
        with comparison_video(tmp_path / name) as video:
            assert video is not None
            for height, width, time_s in shown:
                video.add(np.full((height, width), 0.5), np.full((height, width), 0.2), time_s)
    _, images, times_s = decoded(tmp_path / "one.mp4")
    assert len({image.shape for image in images}) == 1
    np.testing.assert_allclose(np.diff(times_s), [0.25, 1.0, 0.1], atol=0.01)
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "two.mp4").read_bytes()


@pytest.mark.usefixtures("halving")
def test_no_input_is_replaced_and_no_half_video_left(tmp_path: Path) -> None:
    source = tmp_path / "a.mp4"
    with comparison_video(source) as video:
        assert video is not None
        video.add(np.zeros((40, 40)), np.ones((40, 40)))
    before = source.read_bytes()
    out = ["--out", str(tmp_path / "out")]
    with pytest.raises(FactoryError, match=r"--compare .*a\.mp4: "):
        main([str(source), *out, "--compare", str(source)])
    with pytest.raises(FactoryError, match="nothing to denoise"):
        main(["--compare", str(source), *out])
    (tmp_path / "b.png").write_bytes(b"no image")
    with pytest.raises(FactoryError):
        main([str(tmp_path / "b.png"), *out, "--compare", str(tmp_path / "half.mp4")])
    assert source.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.png", "out"]
