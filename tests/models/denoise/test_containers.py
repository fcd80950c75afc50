"""What files say of their images: planes, white, depth, axes, times, shape of pixels, texts."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from PIL import Image as PillowImage

from simnfnd.factory.common.array_types import UInt8s
from simnfnd.factory.common.errors import FrameError
from simnfnd.models.denoise.video_writer import TimedImage, write_video
from simnfnd.models.denoise.writers import write_frames
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.arrays import counting_axis
from simnfnd.models.recordings.fan_tracking import FanTracker
from simnfnd.models.recordings.images import read_image
from simnfnd.models.recordings.videos import VideoProperties
from tests.models.denoise.untrained import main
from tests.models.recordings.fan_images import fan, preset
from tests.models.recordings.recording_files import pings
from tests.models.recordings.video_files import encode

VIDEO = VideoProperties(8, True, Fraction(1, 8), Fraction(8))


def copied_with(source: Path, folder: Path, creation_time: str) -> Path:
    """A video with another video's images, and a time of its own."""
    target = folder / source.name
    folder.mkdir(exist_ok=True)
    with open_recording(source) as recording:
        images = [TimedImage(frame.samples, frame.time_s) for frame in recording]
    video = replace(VIDEO, texts={"creation_time": creation_time})
    write_video(target, source.suffix, images, video)
    return target


def copied(source: Path, folder: Path) -> Path:
    """The file that is written for a recording, with its images as they are."""
    target = folder / "copy" / source.name
    with open_recording(source) as recording:
        images = [TimedImage(frame.samples, frame.time_s, frame.duration_s) for frame in recording]
        write_frames(target, images, recording)
    return target


# --- TIFF -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("pages", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_separate_planes(
    tmp_path: Path, pages: int, dtype: type[np.unsignedinteger[Any]], compression: str | None
) -> None:
    planes = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (pages, 3, 30, 40), dtype)
    path = tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as writer:
        for page in planes:
            writer.write(
                page, photometric="rgb", planarconfig="separate", compression=compression,
                metadata=None,
            )  # fmt: skip
    with open_recording(path) as recording:
        actual = [frame.samples[..., ::-1] for frame in recording]
        assert not recording.warning
    np.testing.assert_array_equal(actual, np.moveaxis(planes, 1, -1))


def test_planes_that_tifffile_describes(tmp_path: Path) -> None:
    planes = pings(3, 30, 40)
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, planes, photometric="rgb", planarconfig="separate")
    with open_recording(path) as recording:
        assert len(recording) == 1
        np.testing.assert_array_equal(recording[0].samples[..., ::-1], np.moveaxis(planes, 0, -1))


@pytest.mark.parametrize("pages", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_white_is_zero(
    tmp_path: Path, pages: int, dtype: type[np.number[Any]], compression: str | None
) -> None:
    levels = np.random.default_rng(0).random((pages, 30, 40))
    white = 1 if dtype is np.float32 else np.iinfo(dtype).max  # type: ignore[type-var]
    images = (levels * white).astype(dtype)
    path = tmp_path / "a.tif"
    stored = (white - images).astype(dtype)
    with tifffile.TiffWriter(path) as writer:
        for page in stored:
            writer.write(page, photometric="miniswhite", compression=compression, metadata=None)
    with open_recording(path) as recording:
        actual = [frame.samples for frame in recording]
        np.testing.assert_allclose(actual, images, atol=1e-6)


@pytest.mark.parametrize("pages", [1, 3])
@pytest.mark.parametrize("kind", ["half floats", "small tiles"])
def test_tiff_that_opencv_does_not_know(tmp_path: Path, pages: int, kind: str) -> None:
    images: Any = pings(pages, 30, 40)
    if kind == "half floats":
        images = (images / 256).astype(np.float16)
    path = tmp_path / "a.tif"
    tile = (16, 16) if kind == "small tiles" else None
    tifffile.imwrite(path, images, tile=tile, photometric="minisblack", metadata=None)
    with open_recording(path) as recording:
        np.testing.assert_array_equal([frame.samples for frame in recording], images)


def test_images_of_one_ome_file_are_sequences(tmp_path: Path) -> None:
    frames = pings(5, 30, 40)
    path = tmp_path / "a.ome.tif"
    with tifffile.TiffWriter(path, ome=True) as writer:
        for _ in range(2):
            writer.write(frames, photometric="minisblack", metadata={"axes": "TYX"})
    with open_recording(path) as recording:
        sequences = [frame.sequence for frame in recording]
    assert sequences == ["image 1"] * 5 + ["image 2"] * 5


def test_interval_and_scale_of_imagej(tmp_path: Path) -> None:
    frames = pings(4, 30, 40)
    about: Any = {"axes": "TYX", "finterval": 0.25, "unit": "mm"}
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, frames, imagej=True, resolution=(20, 10), metadata=about)
    with open_recording(path) as recording:
        assert [frame.time_s for frame in recording] == [0, 0.25, 0.5, 0.75]
    with tifffile.TiffFile(copied(path, tmp_path)) as copy:
        metadata: Any = copy.imagej_metadata
        assert (metadata["finterval"], metadata["unit"]) == (0.25, "mm")
        for tag, value in ((282, 20), (283, 10)):
            numerator, denominator = copy.pages[0].tags[tag].value  # type: ignore[union-attr]
            assert numerator / denominator == value
        np.testing.assert_array_equal(copy.asarray(), frames)


@pytest.mark.parametrize(
    ("text", "shape", "sequences"),
    [
        ("ImageJ=1.5\nimages=6\nchannels=2\nframes=3\n", (5, 7), ["channel 1", "channel 2"] * 3),
        ("ImageJ=1.5\nimages=6\nslices=6\n", (5, 7), [""] * 6),
        (
            "ImageJ=1.5\nimages=4\nslices=2\nframes=2\n",
            (5, 7),
            ["slice 1", "slice 2", "slice 1", "slice 2"],
        ),
        ('{"shape": [2, 3, 5, 7]}', (5, 7), ["part 1"] * 3 + ["part 2"] * 3),
        ('{"shape": [2, 3, 5, 7], "axes": "CTYX"}', (5, 7), ["channel 1"] * 3 + ["channel 2"] * 3),
        ('{"shape": [3, 5, 7]}', (3, 5, 7), [""]),
        ('{"shape": [4, 5, 7, 3]}', (5, 7, 3), [""] * 4),
    ],
)
def test_axes_of_pages(
    tmp_path: Path, text: str, shape: tuple[int, ...], sequences: list[str]
) -> None:
    path = write_described(tmp_path / "a.tif", text, shape, len(sequences))
    with open_recording(path) as recording:
        assert [frame.sequence for frame in recording] == sequences


def write_described(path: Path, text: str, shape: tuple[int, ...], pages: int) -> Path:
    """A TIFF file of pages of one shape, whose first one has this description."""
    planes = {"photometric": "rgb", "planarconfig": "separate" if shape[0] == 3 else "contig"}
    options: Any = planes if len(shape) == 3 else {"photometric": "minisblack"}
    with tifffile.TiffWriter(path) as writer:
        for number in range(pages):
            described: Any = {"description": text} if number == 0 else {}
            page = np.full(shape, number, np.uint8)
            writer.write(page, contiguous=False, metadata=None, **options, **described)
    return path


@pytest.mark.parametrize(
    "text",
    ['{"shape": 3}', '{"shape": [-1, 5, 7]}', '{"shape": [2, 9, 9]}', "ImageJ=\nimages=0", "<OME>"],
)
def test_descriptions_that_say_nothing(tmp_path: Path, text: str) -> None:
    with open_recording(write_described(tmp_path / "a.tif", text, (5, 7), 3)) as recording:
        assert [frame.sequence for frame in recording] == [""] * 3


def test_a_small_page_before_each_image_is_left_out(tmp_path: Path) -> None:
    frames = pings(4, 64, 48)
    marked, plain = tmp_path / "marked.tif", tmp_path / "plain.tif"
    with tifffile.TiffWriter(marked) as writer:
        for frame in frames:
            writer.write(frame[::8, ::8], subfiletype=1, metadata=None)
            writer.write(frame, metadata=None)
    with tifffile.TiffWriter(plain) as writer:
        writer.write(frames[0][::8, ::8], metadata=None)
        for frame in frames:
            writer.write(frame, metadata=None)
    for path, left_out in ((marked, 4), (plain, 1)):
        with open_recording(path) as recording:
            np.testing.assert_array_equal([frame.samples for frame in recording], frames)
            assert f"{left_out} pages are left out" in recording.warning
    single = tmp_path / "single.tif"
    with tifffile.TiffWriter(single) as writer:
        writer.write(frames[0][::8, ::8], subfiletype=1, metadata=None)
        writer.write(frames[0], metadata=None)
    np.testing.assert_array_equal(read_image(single), frames[0])


# --- PGM ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("largest", [100, 1023, 4095, 65534])
@pytest.mark.usefixtures("halving")
def test_the_largest_value_of_pgm(tmp_path: Path, largest: int) -> None:
    samples = np.random.default_rng(0).integers(0, largest + 1, (40, 50))
    stored = samples.astype(np.uint8 if largest < 256 else ">u2").tobytes()
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5\n# a comment\n50 40\n%d\n" % largest + stored)
    with open_recording(path) as recording:
        image = recording[0].samples
    full = np.iinfo(image.dtype).max
    np.testing.assert_allclose(image / full, samples / largest, atol=1 / full)

    for strength, share in (("0", 1.0), ("1", 0.5)):
        out = tmp_path / strength
        words = [str(path), "--out", str(out), "--strength", strength]
        assert main(words) == 0
        header, content = (out / "a.pgm").read_bytes().split(b"\n%d\n" % largest, 1)
        assert header == b"P5\n50 40"
        after = np.frombuffer(content, np.uint8 if largest < 256 else ">u2").reshape(40, 50)
        np.testing.assert_allclose(after, samples * share, atol=0 if share == 1 else 1)


def test_pgm_as_text(tmp_path: Path) -> None:
    path = tmp_path / "a.pgm"
    path.write_text("P2\n3 2\n10\n0 5 10\n10 5 0\n")
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[0].samples, [[0, 128, 255], [255, 128, 0]])


@pytest.mark.usefixtures("halving")
@pytest.mark.parametrize("kind", [b"P3", b"P6"])
def test_colours_of_twelve_bits(tmp_path: Path, kind: bytes) -> None:
    samples = np.random.default_rng(0).integers(0, 4096, (40, 50, 3))
    content = samples.astype(">u2").tobytes()
    if kind == b"P3":
        content = b"# red first\n" + b" ".join(b"%d" % sample for sample in samples.ravel())
    path = tmp_path / "a.ppm"
    path.write_bytes(kind + b"\n50 40\n4095\n" + content)
    with open_recording(path) as recording:
        np.testing.assert_allclose(
            recording[0].samples[..., ::-1] / 65535, samples / 4095, atol=1e-4
        )
    out = tmp_path / "out"
    assert main([str(path), "--out", str(out), "--strength", "0", "--geometry", "none"]) == 0
    header, result = (out / "a.ppm").read_bytes().split(b"\n4095\n", 1)
    assert header == b"P6\n50 40"
    np.testing.assert_array_equal(np.frombuffer(result, ">u2"), samples.ravel())


def test_a_map_of_several_images_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pgm"
    path.write_bytes((b"P5\n3 2\n255\n" + bytes(6)) * 2)
    with open_recording(path) as recording, pytest.raises(FrameError, match=r"a\.pgm"):
        recording[0]


# --- MATLAB ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "axis"),
    [
        ((20, 388, 200), 0),
        ((8, 388, 200), 0),
        ((388, 200, 20), -1),
        ((388, 200, 8), -1),
        ((2000, 48, 300), -1),
        ((64, 64, 64), -1),
        ((30, 40, 4), -1),
        ((20, 30, 40, 3), 0),
        ((30, 40, 3, 20), -1),
        ((30, 40), None),
        ((30, 40, 3), None),
    ],
)
def test_the_axis_that_counts_images(shape: tuple[int, ...], axis: int | None) -> None:
    assert counting_axis(shape, is_matlab=True) == axis


@pytest.mark.parametrize("version", [5, 73])
def test_matlab_with_images_first(tmp_path: Path, version: int) -> None:
    frames = pings(20, 60, 50)
    path = tmp_path / "a.mat"
    if version == 5:
        scipy.io.savemat(path, {"frames": frames})
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            stored = file.create_dataset("frames", data=frames.transpose())
            stored.attrs["MATLAB_class"] = np.bytes_("uint8")
        path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])
    with open_recording(path) as recording:
        np.testing.assert_array_equal([frame.samples for frame in recording], frames)
        assert not recording.warning


@pytest.mark.parametrize("kind", ["mat", "last", "colours"])
def test_arrays_of_which_either_end_may_count(tmp_path: Path, kind: str) -> None:
    """One line says which was taken."""
    path = tmp_path / ("a.mat" if kind == "mat" else "a.npy")
    if kind == "mat":
        scipy.io.savemat(path, {"frames": pings(50, 60, 70)})
    elif kind == "last":
        np.save(path, np.moveaxis(pings(20, 60, 50), 0, -1))
    else:
        np.save(path, pings(3, 60, 50))
    with open_recording(path) as recording:
        assert "axis" in recording.warning


# --- videos ---------------------------------------------------------------------------------------


def texts_of(path: Path) -> tuple[dict[str, str], Fraction]:
    """The metadata of a video's container, and the width of its pixels by their height."""
    av: Any = import_module("av")
    with av.open(str(path)) as container:
        aspect = container.streams.video[0].sample_aspect_ratio
        return dict(container.metadata), Fraction(aspect or 1)


@pytest.mark.parametrize(
    ("suffix", "codec", "texts"),
    [
        (".mkv", "ffv1", ("creation_time", "title", "comment")),
        (".mp4", "libx264", ("creation_time", "title", "comment")),
        (".mov", "png", ("creation_time", "title", "comment")),
        (".avi", "ffv1", ("title", "comment", "date")),
    ],
)
def test_texts_and_pixels_of_videos(
    tmp_path: Path, suffix: str, codec: str, texts: tuple[str, ...]
) -> None:
    av: Any = import_module("av")
    path = tmp_path / f"a{suffix}"
    said = {"creation_time": "2025-09-24T10:31:20.000000Z", "title": "dive 7", "comment": "calm"}
    with av.open(str(path), "w") as output:
        output.metadata.update(said)
        stream = output.add_stream(codec, rate=8)
        stream.height, stream.width = 40, 60
        stream.pix_fmt = "yuv420p" if codec == "libx264" else "gray"
        stream.codec_context.sample_aspect_ratio = Fraction(16, 15)
        for image in pings(3, 40, 60):
            output.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        output.mux(stream.encode(None))
    copies = [copied(path, tmp_path / number) for number in "12"]
    metadata, aspect = texts_of(copies[0])
    assert aspect == texts_of(path)[1] or suffix in (".mkv", ".avi")
    lower = {name.lower(): text for name, text in metadata.items()}
    said["date"] = said["creation_time"]  # all that AVI has
    if suffix == ".avi":
        copied_texts, _ = texts_of(copied_with(path, tmp_path / "3", said["creation_time"]))
        lower["date"] = copied_texts["date"]
    assert {name: lower.get(name) for name in texts} == {name: said[name] for name in texts}
    assert copies[0].read_bytes() == copies[1].read_bytes()


@pytest.mark.parametrize("suffix", [".mkv", ".avi", ".webm"])
def test_a_shape_of_pixels_that_is_not_stated_is_named(tmp_path: Path, suffix: str) -> None:
    images = [TimedImage(frame, number / 8) for number, frame in enumerate(pings(3, 88, 60))]
    path = tmp_path / f"a{suffix}"
    note = write_video(path, suffix, images, replace(VIDEO, pixel_aspect=Fraction(12, 11)))
    assert ("(12:11, width by height) is lost" in note) == (texts_of(path)[1] != Fraction(12, 11))
    assert not write_video(path, suffix, images, VIDEO)


def test_transparency_that_is_not_kept_is_named(tmp_path: Path) -> None:
    av: Any = import_module("av")
    image = np.dstack([np.full((40, 60, 3), 200, np.uint8), np.full((40, 60), 9, np.uint8)])
    with av.open(str(tmp_path / "a.mov"), "w") as output:
        stream = output.add_stream("png", rate=8)
        stream.height, stream.width, stream.pix_fmt = 40, 60, "rgba"
        output.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgba")))
        output.mux(stream.encode(None))
    frames = [PillowImage.fromarray(image - np.uint8(shift)) for shift in range(3)]
    frames[0].save(tmp_path / "a.webp", save_all=True, append_images=frames[1:], lossless=True)
    for name in ("a.mov", "a.webp"):
        with open_recording(tmp_path / name) as recording:
            list(recording)
            assert "transparency" in recording.warning


def test_two_frames_at_one_time(tmp_path: Path) -> None:
    times_ms = [0, 125, 125, 375]
    path = encode(tmp_path / "a.mkv", pings(4, 40, 60), times_ms=times_ms)
    with open_recording(copied(path, tmp_path)) as copy:
        assert [frame.time_s for frame in copy] == [time / 1000 for time in times_ms]


# --- titles ---------------------------------------------------------------------------------------


def title(shape: tuple[int, ...], number: int) -> UInt8s:
    image: Any = np.zeros(shape, np.uint8)
    for row in range(30 + 7 * number % 40, shape[0], 60):
        cv2.putText(image, "Dive 7", (10, row), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255,), 2)
    return np.asarray(image, np.uint8)


@pytest.mark.parametrize(("kind", "count"), [("still", 1), ("moving", 5), ("black", 12)])
def test_a_fan_behind_titles_is_found_at_once(kind: str, count: int) -> None:
    image, _ = fan(preset("didson_hf", 220, 400), 0.2, holes=False)
    tracker = FanTracker()
    for number in range(count):
        shown = title(image.shape, number if kind == "moving" else 0)
        assert tracker.geometry(shown * (kind != "black")) is None
    assert all(tracker.geometry(image) is not None for _ in range(3))
