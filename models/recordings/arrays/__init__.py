"""Arrays as pictures and recordings: NumPy (.npy, .npz), MATLAB (.mat) and HDF5 files of anybody.

A format is a module here with a `base.Arrays`; its line below says which files it reads.  Where a
file holds several arrays of pictures, `FILE::NAME` says which is meant.
"""

from __future__ import annotations

from pathlib import Path

from ..base import ARRAY_SUFFIX

_ROOM = "simnfnd.models.recordings.arrays"
MATLAB_SUFFIX = ".mat"
HDF5_SUFFIXES = (".h5", ".hdf5")
FORMATS = {
    ARRAY_SUFFIX: f"{_ROOM}.npy:Npy",
    ".npz": f"{_ROOM}.npz:Npz",
    MATLAB_SUFFIX: f"{_ROOM}.matlab:open_matlab",
    **dict.fromkeys(HDF5_SUFFIXES, f"{_ROOM}.hdf5:Hdf5"),
}
"""Suffix -> "module:what opens such a file"."""
_SEPARATOR = "::"


def split_name(path: str | Path) -> tuple[Path, str | None]:
    """The file and the name of the array in it, of FILE::NAME; None where no name is given."""
    where = Path(path)
    file, separator, name = str(path).partition(_SEPARATOR)
    named = bool(separator and name) and Path(file).suffix.lower() in FORMATS
    return (Path(file), name) if named and not where.exists() else (where, None)


def file_of(path: str | Path) -> Path:
    """The file of FILE or FILE::NAME."""
    return split_name(path)[0]
