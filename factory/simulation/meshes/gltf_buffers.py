"""Numbers and images in the buffers of a glTF document, checked against the bytes there are."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...common.array_types import Array, Float64s
from ...common.errors import FactoryError

Document = dict[str, Any]

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Buffers:
    """What a document's accessors and images hold."""

    def __init__(self, document: Document, folder: Path, chunk: bytes) -> None:
        """folder: of the document.  chunk: that of a .glb, the buffer without an address."""
        self.document = document
        self._folder = folder
        self._chunk = chunk
        self._contents: dict[str, bytes] = {}

    def stored(self, number: int) -> Array:
        """(N, width) of an accessor as it is stored.

        Raises ValueError or KeyError for an accessor that the buffers do not hold.
        """
        accessor = self.document["accessors"][number]
        count = int(accessor["count"])
        width = _WIDTHS[accessor["type"]]
        values: Array = np.zeros((count, width), _TYPES[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._read(accessor, accessor["componentType"], count, width)
        if "sparse" in accessor:
            values = self._with_exceptions(values.copy(), accessor)
        return values

    def numbers(self, number: int) -> Float64s:
        """(N, width) of an accessor; normalised integers as fractions of their largest number."""
        values = self.stored(number)
        is_normalised = self.document["accessors"][number].get("normalized", False)
        numbers = values.astype(np.float64)
        if is_normalised and values.dtype.kind in "iu":
            largest = float(np.iinfo(values.dtype.name).max)
            return np.maximum(numbers / largest, -1.0)
        return numbers

    def image_content(self, number: int) -> bytes:
        """The bytes of an image file."""
        image = self.document["images"][number]
        if "bufferView" in image:
            return bytes(self._view(image["bufferView"]))
        return self._content(image["uri"])

    def _with_exceptions(self, values: Array, accessor: Document) -> Array:
        """The values with those replaced that a sparse accessor lists."""
        sparse = accessor["sparse"]
        count = int(sparse["count"])
        if not 0 <= count <= len(values):
            raise ValueError("a sparse accessor replaces more elements than there are")
        indices = sparse["indices"]
        replacing = sparse["values"]
        rows = self._read(indices, indices["componentType"], count, 1)[:, 0]
        kind = accessor["componentType"]
        values[rows.astype(np.int64)] = self._read(replacing, kind, count, values.shape[1])
        return values

    def _read(self, location: Document, component_type: int, count: int, width: int) -> Array:
        """(count, width) elements at a location in a buffer view."""
        view = self.document["bufferViews"][location["bufferView"]]
        dtype = np.dtype(_TYPES[component_type])
        step = int(view.get("byteStride", width * dtype.itemsize))
        # numpy refuses a shape that reaches beyond the buffer.
        return np.ndarray(
            (count, width),
            dtype,
            self._view(location["bufferView"]),
            int(location.get("byteOffset", 0)),
            (step, dtype.itemsize),
        )

    def _view(self, number: int) -> memoryview:
        view = self.document["bufferViews"][number]
        for name in view.get("extensions", {}):
            if name.endswith("meshopt_compression"):
                raise FactoryError(f"uses {name}, which is not read; export it uncompressed")
        start = int(view.get("byteOffset", 0))
        end = start + int(view["byteLength"])
        content = memoryview(self._buffer(view["buffer"]))
        if not 0 <= start <= end <= len(content):
            raise ValueError(f"buffer view {number} reaches beyond its buffer")
        return content[start:end]

    def _buffer(self, number: int) -> bytes:
        buffer = self.document["buffers"][number]
        return self._content(buffer["uri"]) if "uri" in buffer else self._chunk

    def _content(self, address: str) -> bytes:
        """Bytes in an address itself, or those of a file, which `files_of` has looked at."""
        if address not in self._contents:
            is_data = address.startswith("data:")
            self._contents[address] = (
                base64.b64decode(address.partition(",")[2])
                if is_data
                else (self._folder / unquote(address)).read_bytes()
            )
        return self._contents[address]
