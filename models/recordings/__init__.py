"""Reads recordings of real sonars, videos and images: `open_recording`.

A reader is a module here with a class that takes a path and is a `base.Recording`; its line below
says which files it reads.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from ...factory.common.errors import FactoryError
from ...factory.common.extras import Need, require
from .base import (
    ANIMATED_SUFFIXES,
    ARRAY_SUFFIXES,
    HDF5_SUFFIXES,
    IMAGE_SUFFIXES,
    TIFF_SUFFIXES,
    Recording,
    SonarFrame,
)
from .extension_files import ExtensionFile, entry_for, entry_of, known_suffixes

__all__ = ["IMAGE_SUFFIXES", "Recording", "SonarFrame", "is_recording", "kind_of", "open_recording"]

READERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "aris": ("sonar_files:ArisFile", (".aris",)),
    "ddf": ("sonar_files:DdfFile", (".ddf",)),
    "oculus": ("sonar_files:OculusFile", (".raw", ".oculus")),
    "rosbag": ("rosbag:RosBag", (".bag", ".mcap", ".db3")),
    "video": ("videos:VideoFile", (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm")),
    "stack": ("tiff_files:StackFile", ()),
    "animation": ("animations:Animation", (".gif", ".apng")),
    "array": ("arrays:ArrayFile", (".npz", ".mat")),
    "images": ("images:ImageFiles", IMAGE_SUFFIXES),
    "dataset": ("simulated:DatasetRecording", ()),
}
"""Kind -> ("module:class", suffixes of its files); `kind_of` says what else files of images are."""

DATASET = "dataset"
"""Kind of the recordings of a dataset: `DATASET/LOCATION/SCENE`, which is no file."""
SEQUENCES = ("video", "stack", "animation", "array")
"""Kinds whose frames are images, one after the other."""


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder is a bag of ROS 2: metadata.yaml beside files that hold messages."""
    return (folder / "metadata.yaml").is_file() and any(
        {".db3", ".mcap"} & set(file.suffixes) for file in folder.iterdir()
    )


def kind_of(path: Path) -> str | None:
    """The kind of recording that a file's name says; None for others.

    A TIFF file of several pages is a `stack`, a PNG or WebP file of several frames an `animation`;
    a .npy file of several images, .npz, .mat, and HDF5 files that are no shard of a dataset are
    an `array`, and of no kind when they hold no images.  A folder is `rosbag` when it holds a bag
    of ROS 2, and `images` otherwise.  A path that names a scene of a dataset, and no file, is a
    `dataset`.
    """
    if not path.exists() and dataset_of(path) is not None:
        return DATASET
    if path.is_dir():
        return "rosbag" if is_bag_folder(path) else "images"
    entry = entry_for(path)
    if entry is not None:
        return entry.kind
    suffix = path.suffix.lower()
    if path.is_file():
        if suffix in (*ARRAY_SUFFIXES, *HDF5_SUFFIXES):
            from .arrays import is_shard_file, kind_of_array

            is_shard = suffix in HDF5_SUFFIXES and is_shard_file(path)
            return None if is_shard else kind_of_array(path)
        if suffix in TIFF_SUFFIXES:
            from .tiff_files import is_stack

            return "stack" if is_stack(path) else "images"
        if suffix in ANIMATED_SUFFIXES:
            from .animations import is_animated

            return "animation" if is_animated(path) else "images"
    return next((kind for kind, (_, known) in READERS.items() if suffix in known), None)


def suffixes_known() -> list[str]:
    """The suffixes of all files that can be read, those of other packages included."""
    own = [suffix for _, suffixes in READERS.values() for suffix in suffixes]
    return [*own, *known_suffixes()]


def refuse_absent(path: Path) -> None:
    """Raise FactoryError for what is neither file nor folder; a pipe would make wait for ever."""
    if not path.exists():
        raise FactoryError(f"{path}: no such file or folder")
    if not (path.is_file() or path.is_dir()):
        raise FactoryError(f"{path}: is a pipe or device; give a file or folder")


def is_recording(path: Path) -> bool:
    """Whether a file or folder is one by its name: of a sonar, a bag or a video, not images."""
    kind = kind_of(path)
    return kind == DATASET or (path.exists() and kind not in (None, "images"))


def dataset_of(path: Path) -> Path | None:
    """The folder of the dataset that a path, DATASET or DATASET/LOCATION/SCENE, names or None."""
    for folder in (path, *path.parents[:2]):
        manifest = folder / "manifest.json"
        with suppress(OSError, ValueError):
            if not manifest.is_file():
                continue
            with manifest.open("rb") as file:
                # It begins with the name of its format: other programs have files of this name.
                if b'"simnfnd/' in file.read(64):
                    return folder
    return None


def open_recording(path: str | Path, topics: Sequence[str] = ()) -> Recording:
    """The recording in a file or folder.

    topics: of a bag, as `RosBag` takes them.
    Raises FactoryError when there is none, it is of no known kind, or nothing of it can be read.
    """
    location = Path(path).expanduser()
    is_dataset = dataset_of(location) == location or kind_of(location) == DATASET
    if not is_dataset:
        refuse_absent(location)
    is_array = location.suffix.lower() in (*ARRAY_SUFFIXES, *HDF5_SUFFIXES)
    kind = DATASET if is_dataset else kind_of(location)
    if kind is None and is_array:
        kind = "array"  # which says what it lacks
    if kind is None:
        known = ", ".join(suffixes_known())
        raise FactoryError(f"{path}: not a recording by its name ({known}, or a folder)")
    if kind not in READERS:
        return ExtensionFile(location, entry_of(kind))
    module, name = READERS[kind][0].split(":")
    if module not in ("sonar_files", "simulated"):
        require([Need(f"{path}", "cv2")])
    reader = getattr(import_module(f".{module}", __name__), name)
    recording: Recording = reader(location, topics) if kind == "rosbag" else reader(location)
    return recording
