"""Real sonar images as training data: images, frames of recordings, and OldData of them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
from scipy import ndimage

from ...factory.common.array_types import Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.files import sha256_of
from ...factory.dataset.fan_geometry import FanGeometry
from ...factory.simulation.imaging.contract import effect_clouds
from ...factory.simulation.imaging.pointwise import noisy_cloud
from ...factory.simulation.noise.draws import Draws, StreamNames, draw
from ...factory.simulation.noise.registry import NoiseSettings
from ...factory.simulation.sonar.polar import Echoes, in_plane
from ...factory.simulation.sonar.window import Window
from ..recordings import IMAGE_SUFFIXES, is_recording, kind_of, open_recording
from ..recordings.fan_tables import read_fans
from ..recordings.views import frame_image
from ..settings import OldData
from .pairs import ImageSource, SampleRef, TrainingImage, weakened

_FAR_M = 10.0  # of the far edge: the noise knows fractions of the range alone, so any would do
_SPREAD_PX = 0.7
_DARK = 0.02  # a pixel at or below is shadow, as the paper's threshold on T has it
_LOOKS = 4  # echoes that stand for one pixel; more make smoother noise


def list_images(folder: str | Path, key: str = "data.folder") -> tuple[SampleRef, ...]:
    """The images of a folder and its subfolders and the frames of recordings in it, by name.

    folder: or one recording.  `scene` is the subfolder, and of a frame the recording.
    Raises FactoryError, naming `key`, when there is none.
    """
    root = Path(folder).expanduser()
    single = is_recording(root)
    if not single and not root.is_dir():
        raise FactoryError(f"{key}={folder}: no such folder or recording")
    samples: list[SampleRef] = []
    for path in [root] if single else sorted(entry for entry in root.rglob("*") if entry.is_file()):
        place = path.relative_to(root.parent if single else root)
        if is_recording(path):
            with open_recording(path) as recording:
                rows = range(len(recording))
            scene = place.as_posix()
            samples += [SampleRef(path, row, scene, f"{path.name}#{row}") for row in rows]
        elif kind_of(path) == "images":
            samples.append(SampleRef(path, 0, place.parent.as_posix(), path.name))
    if not samples:
        kinds = ", ".join(IMAGE_SUFFIXES)
        raise FactoryError(f"{key}={folder}: holds no image ({kinds}) and no recording")
    return tuple(samples)


def read_sample(sample: SampleRef) -> tuple[Float32s, FanGeometry | None]:
    """An image as (H, W) float32 in 0..1, and its geometry where its recording tells it.

    A ping becomes a fan.  Raises FactoryError when it cannot be read.
    """
    return frame_image(sample.path, sample.row)


def smallest_side(samples: tuple[SampleRef, ...]) -> tuple[int, SampleRef]:
    """The shortest side of all images, pixels, and the image that has it."""
    # The frames of a recording are of one size, or nearly.
    sides = [(min(read_sample(sample)[0].shape), sample) for sample in samples if sample.row == 0]
    return min(sides, key=itemgetter(0))


def digest_of(samples: Sequence[SampleRef]) -> str:
    """Changes with the names and the content of image files, not with where they lie."""
    hashes = {path: sha256_of(path) for path in {sample.path for sample in samples}}
    contents = [(sample.scene, sample.frame, hashes[sample.path]) for sample in samples]
    return hashlib.blake2b(repr(contents).encode(), digest_size=8).hexdigest()


class OldDataSource(ImageSource):
    """Real images taken as clean, the factory's noise on top (Table 3, OldData).

    A real image keeps its own noise in the "clean" image, so a network learns to leave noise of
    that kind alone.
    """

    images: tuple[SampleRef, ...]

    def __init__(
        self, samples: tuple[SampleRef, ...], data: OldData, noise: NoiseSettings, seed: int
    ) -> None:
        """Raises FactoryError when an image is not in the table `data.geometry`."""
        self.images = samples
        self.noise = noise
        self.weaker = data.weaker
        self.seed = seed
        self.fans = {} if data.geometry == "polar" else read_fans(data.geometry)
        images = (sample for sample in samples if self.fans and not is_recording(sample.path))
        unknown = [sample.frame for sample in images if sample.frame not in self.fans]
        if unknown:
            raise FactoryError(
                f"data.geometry={data.geometry}: says nothing about {unknown[0]} and "
                f"{len(unknown) - 1} more images; add them, or give another data.folder"
            )

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        ref = self.images[index]
        clean, known_geometry = read_sample(ref)
        geometry = self.fans.get(ref.frame, known_geometry or FanGeometry.polar()).with_size(
            *clean.shape
        )
        sector = geometry.maps(0, 0, *clean.shape)["sector"]
        clean = clean * sector
        number = "validation" if visit is None else visit
        names = StreamNames.single(ref.scene, ref.frame, number)
        noisy = with_noise(clean, geometry, draw(self.noise, self.seed, names))
        if visit is not None:
            strength = np.float32(weakened(self.weaker, self.seed, index, visit))
            noisy = clean + strength * (noisy - clean)
        shadow = (sector > 0) & (clean <= _DARK)
        return TrainingImage(noisy, clean, shadow.astype(np.float32), geometry)


def with_noise(clean: Float32s, geometry: FanGeometry, draws: Draws) -> Float32s:
    """An image (H, W) in 0..1 with the drawn effects on it, clipped to 0..1.

    Every pixel that is not black is four echoes, which range spreading moves along their bearing
    before they are gathered again; the other effects add echoes, blurred by 0.7 pixels.
    """
    maps = geometry.maps(0, 0, *clean.shape)
    lit = (clean > 0) & (maps["sector"] > 0)
    if not lit.any():
        return clean
    azimuth = np.repeat(maps["azimuth_rad"][lit], _LOOKS)
    range_m = np.repeat(maps["range_fraction"][lit] * np.float32(_FAR_M), _LOOKS)
    scene = in_plane(range_m, azimuth, np.repeat(clean[lit] / np.float32(_LOOKS), _LOOKS))
    limits = (geometry.near_fraction * _FAR_M, _FAR_M)
    window = Window("slant_range", *limits, geometry.azimuth_min_rad, geometry.azimuth_max_rad)
    moved, *added = noisy_cloud(scene, effect_clouds(draws.effects, scene, window), 1.0)
    image = _gathered(moved, geometry, clean.shape)
    for echoes in added:
        points = _gathered(echoes, geometry, clean.shape)
        image += ndimage.gaussian_filter(points, _SPREAD_PX, mode="constant", truncate=3.0)
    return np.clip(image * maps["sector"], 0, 1).astype(np.float32)


def _gathered(echoes: Echoes, geometry: FanGeometry, shape: tuple[int, ...]) -> Float32s:
    """Sum of the echoes' strengths in each pixel; those outside the image are lost."""
    height, width = shape
    fraction = echoes.range_m / np.float32(_FAR_M)
    row, column = (
        np.rint(place).astype(np.intp) for place in geometry.pixels(fraction, echoes.azimuth_rad)
    )
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    inside &= (fraction >= geometry.near_fraction - 1e-6) & (fraction <= 1 + 1e-6)
    index = row[inside] * width + column[inside]
    level = np.bincount(index, weights=echoes.strength[inside], minlength=height * width)
    return np.asarray(level.reshape(height, width), dtype=np.float32)
