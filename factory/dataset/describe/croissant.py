"""croissant.json: the dataset in MLCommons Croissant 1.0, which search engines and loaders read.

Written as plain JSON-LD; the mlcroissant package is only needed by those who read it.  It lists
every file with its SHA-256, says what the pictures and columns are, and its record set `shards`
loads (from manifest.json) with mlcroissant.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...files import sha256_of, write_atomically
from ..format.echoes import PLACE, echo_names
from ..format.layout import optional_layers
from ..format.manifest import INDEX_NAME, MANIFEST_NAME, Manifest
from ..format.schema import SCHEMA, SPLITS
from ..format.settings import DatasetSettings
from ..read.reader import reading
from .card import PAPER

CROISSANT_NAME = "croissant.json"

_HDF5 = "application/x-hdf5"
# The vocabulary of Croissant 1.0, which every file has to spell out.
_CROISSANT_TERMS = (
    "citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty",
    "fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField",
    "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate", "separator",
    "source", "subField", "transform",
)  # fmt: skip
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _CROISSANT_TERMS},
}
# Field of manifest.json's shards -> (Croissant type, what it is).
_SHARD_FIELDS = {
    "path": ("sc:Text", "file below the dataset's folder"),
    "split": ("sc:Text", "train or test; no place is in both"),
    "samples": ("sc:Integer", "number of samples in the file"),
    "bytes": ("sc:Integer", "size of the file"),
    "sha256": ("sc:Text", "SHA-256 of the file"),
}


def write_croissant(directory: Path, manifest: Manifest, settings: DatasetSettings) -> Path:
    """Write croissant.json beside a saved manifest.json and return its path.

    Raises FactoryError when the first shard cannot be read.  Equal datasets give equal bytes.
    """
    document: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": settings.name,
        "description": _description(manifest),
        "citeAs": PAPER,
        "version": manifest.generator.split()[-1],
        "keywords": ["sonar", "forward-looking sonar", "denoising", "underwater", "synthetic"],
        "isLiveDataset": False,
        "variableMeasured": _variables(directory, manifest),
        "distribution": _files(directory, manifest),
        "recordSet": [_shard_records()],
    }
    if settings.licence:
        document["license"] = settings.licence
    path = directory / CROISSANT_NAME
    write_atomically(path, (json.dumps(document, indent=1) + "\n").encode())
    return path


def _description(manifest: Manifest) -> str:
    splits = " and ".join(f"{manifest.samples(split)} {split}" for split in SPLITS)
    return (
        f"{manifest.samples()} pairs ({splits}) of simulated forward-looking-sonar images: noisy, "
        f"clean, and the mask of acoustic shadow, in HDF5 ({SCHEMA}). Every shard holds the stacks "
        "/noisy, /clean and /shadow and the table /meta, one row a sample. Config hash "
        f"{manifest.config_hash}."
    )


def _files(directory: Path, manifest: Manifest) -> list[dict[str, Any]]:
    files = [_file(directory / MANIFEST_NAME, MANIFEST_NAME, "application/json")]
    if (directory / INDEX_NAME).exists():
        files.append(_file(directory / INDEX_NAME, INDEX_NAME, _HDF5))
    for path in sorted(manifest.shards):
        shard = manifest.shards[path]
        files.append(_file_object(path, _HDF5, shard.bytes, shard.sha256))
    return files


def _file(path: Path, name: str, encoding: str) -> dict[str, Any]:
    return _file_object(name, encoding, path.stat().st_size, sha256_of(path))


def _file_object(name: str, encoding: str, size: int, sha256: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{size} B",
        "encodingFormat": encoding,
        "sha256": sha256,
    }


def _shard_records() -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": "shards",
        "name": "shards",
        "description": "The HDF5 files that make up the dataset.",
        "key": {"@id": "shards/path"},
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"shards/{name}",
                "name": name,
                "description": meaning,
                "dataType": data_type,
                "source": {
                    "fileObject": {"@id": MANIFEST_NAME},
                    "extract": {"jsonPath": f"$.shards[*].{name}"},
                },
            }
            for name, (data_type, meaning) in _SHARD_FIELDS.items()
        ],
    }


def _variables(directory: Path, manifest: Manifest) -> list[dict[str, str]]:
    """The pictures and the columns of /meta, as the first shard describes them."""
    variables = []
    with reading(directory / min(manifest.shards)) as file:
        for name in ("noisy", "clean", "shadow", *optional_layers(file)):
            stack = file[name]
            _, rows, columns, *channels = stack.shape
            kind = " x ".join(map(str, (stack.dtype, *channels)))
            size = f"{kind} image of {rows} x {columns} pixels"
            meaning = f"{stack.attrs['description']} ({size})"
            variables.append(_variable(f"/{name}", meaning, str(stack.attrs["units"])))
        for name in echo_names(file):
            meaning, units = (str(file[name].attrs[key]) for key in ("description", "units"))
            meaning = f"{meaning} ({file[name].dtype} list, /{PLACE} has where each sample's is)"
            variables.append(_variable(f"/{name}", meaning, units))
        table = file["meta"]
        for name in table.dtype.names:
            meaning, units = (
                str(table.attrs.get(f"{name}.{key}", "")) for key in ("description", "units")
            )
            variables.append(_variable(f"/meta {name}", meaning, units))
    return variables


def _variable(name: str, meaning: str, units: str) -> dict[str, str]:
    entry = {"@type": "PropertyValue", "name": name, "description": meaning, "unitText": units}
    return {key: value for key, value in entry.items() if value}
