"""Recordings of a dataset: the noisy images of a scene, in the order of time."""

from __future__ import annotations

from pathlib import Path

from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from ...factory.dataset.pair_dataset import PairDataset
from . import dataset_of
from .base import Recording, RecordingDevice, SonarFrame, known


class DatasetRecording(Recording):
    """A recording that `DATASET/LOCATION/SCENE` names; a dataset of one scene does without.

    Frames are noisy images with the geometry that the dataset states.
    """

    def __init__(self, path: Path) -> None:
        """Raises FactoryError when the dataset cannot be read, or has no such recording."""
        self.path = path
        self.warning = ""
        self.files = []
        self._open()

    def _open(self) -> None:
        folder = dataset_of(self.path)
        if folder is None:
            raise FactoryError(f"{self.path}: in no dataset")
        self._pairs = PairDataset(folder, "all", layers=["noisy"])
        name = self.path.relative_to(folder).as_posix()
        names = self._pairs.recordings.names
        if name == "." and len(names) > 1:
            raise FactoryError(
                f"{folder}: a dataset of {len(names)} recordings; give one, such as "
                f"{folder / names[0]}"
            )
        self.name = names[0] if name == "." else name
        self._samples = self._pairs.recordings.samples(self.name)
        self._table = self._pairs.meta()
        self._sonar = recorded_sonar(self._pairs.form.config)
        self.count = len(self._samples)

    def _read(self, number: int) -> SonarFrame:
        sample = self._samples[number]
        record = self._table[sample]
        has_time = "time_s" in (self._table.dtype.names or ())
        geometry = None if self._sonar is None else FanGeometry.from_record(self._sonar, record)
        return SonarFrame(
            number,
            self._pairs[sample]["noisy"],
            time_s=known(record["time_s"]) if has_time else None,
            device=RecordingDevice("simulated" if self._sonar is None else self._sonar.name),
            geometry=geometry,
        )

    def close(self) -> None:
        """Close the files."""
        self._pairs.close()

    def __del__(self) -> None:
        """Does nothing: the dataset closes its own files, at the end of Python too."""
