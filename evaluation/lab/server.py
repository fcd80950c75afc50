"""What the page of the lab asks for, and the answers: images, charts, exports."""

from __future__ import annotations

import base64
import json
import time
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import unquote, urlsplit

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.common.array_types import Array, UInt8s
from ...factory.common.errors import FactoryError
from ...factory.common.settings import STRICT, build
from ...factory.dataset.schema import Pair
from ...factory.simulation.config.root import FactoryConfig
from ..viewer.page_server import Answer, PageServer, UnknownPath, json_answer
from ..viewer.viewer import ShownRecording
from .charts import charts_of
from .session import Session

DRAWS = 6
_FOLDER = Path(__file__).parent
_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/charts.js": ("charts.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
Right = Literal["clean", "unchanged", "real"]


@dataclass(frozen=True, config=STRICT)
class Request:
    """What the page wants to see.

    changes: parameters, as plain values by dotted key.  frame: its number.  variant: of its pairs.
    right: the image to compare with: clean, the noisy one with no parameter changed, or real.
    real: number of the recording's frame.  sweep: the marked parameter and its values.
    """

    changes: dict[str, Any] = Field(default_factory=dict)
    frame: Annotated[int, Field(ge=0)] = 0
    variant: Annotated[int, Field(ge=0)] = 0
    right: Right = "clean"
    real: Annotated[int, Field(ge=0)] = 0
    sweep: tuple[str, str] | None = None


class LabServer(PageServer):
    """Serves the page of `simnfnd lab`.

    session: makes the images.  frame: the number of the one that is shown first.
    """

    verb = "lab"

    def __init__(
        self, session: Session, real: Path | None = None, frame: int = 0, port: int = 0
    ) -> None:
        """real: an image or recording.  Raises FactoryError when it cannot be read."""
        self.real = None if real is None else ShownRecording(real)
        super().__init__(port)
        self.session = session
        self._first_frame = frame
        self._unchanged = lru_cache(maxsize=2)(self._make_unchanged)

    def answer(self, path: str) -> Answer:
        """See `PageServer`."""
        parts = urlsplit(path)
        if parts.path in _FILES:
            name, mime_type = _FILES[parts.path]
            return Answer(mime_type, (_FOLDER / name).read_bytes())
        if parts.path == "/about.json":
            return json_answer(self._about())
        if parts.path == "/images.json":
            return json_answer(self._images(self._request(parts.query)))
        if parts.path == "/draws.json":
            return json_answer(self._draws(self._request(parts.query)))
        raise UnknownPath

    def _about(self) -> dict[str, Any]:
        session = self.session
        return {
            "words": " ".join(session.words),
            "seed": session.config.seed,
            "frames": [ref.name for ref in session.frames],
            "frame": self._first_frame,
            "real": None if self.real is None else self.real.title,
            "real_frames": 0 if self.real is None else len(self.real),
            "parameters": [parameter.plain() for parameter in session.parameters],
        }

    def _request(self, query: str) -> Request:
        """Raises FactoryError for what is no request, or names a frame that is not there."""
        try:
            values = json.loads(unquote(query) or "{}")
        except ValueError as error:
            raise FactoryError(f"request: not JSON ({error})") from error
        if not isinstance(values, dict):
            raise FactoryError("request: not an object of JSON")
        request: Request = build(Request, values, "request")
        counts = {"frame": len(self.session.frames)}
        if request.right == "real":
            counts["real"] = 0 if self.real is None else len(self.real)
        for name, count in counts.items():
            if getattr(request, name) >= count:
                raise FactoryError(f"request.{name}: must be below {count}")
        return request

    def _images(self, request: Request) -> dict[str, Any]:
        """Both images of a request with what was drawn, keys without effect, and exports."""
        begun = time.perf_counter()
        session = self.session
        (pair,) = session.pairs(request.changes, request.frame, (request.variant,))
        ended = time.perf_counter()
        config = session.configured(request.changes)
        is_polar = config.sonar.image.layout == "polar"
        return {
            "is_polar": is_polar,
            "left": _shown(_grey(pair.noisy)),
            "right": _shown(self._right(request, pair, is_polar=is_polar)),
            "drawn": _drawn(pair),
            "inert": self._inert(config, request),
            "exports": session.exports(request.changes, request.sweep)._asdict(),
            "milliseconds": round(1000 * (ended - begun)),
        }

    def _inert(self, config: FactoryConfig, request: Request) -> dict[str, str]:
        keys = [parameter.key for parameter in self.session.parameters]
        return self.session.inert(config, keys, request.changes)

    def _right(self, request: Request, pair: Pair, *, is_polar: bool) -> UInt8s:
        if request.right == "clean":
            return _grey(pair.clean)
        if request.right == "unchanged":
            return self._unchanged(request.frame, request.variant)
        assert self.real is not None
        read = self.real.polar_image if is_polar else self.real.image
        image = read(request.real, 0)
        return image if image.ndim == 2 else np.asarray(np.rint(image.mean(axis=-1)), np.uint8)

    def _make_unchanged(self, frame: int, variant: int) -> UInt8s:
        (pair,) = self.session.pairs({}, frame, (variant,))
        return _grey(pair.noisy)

    def _draws(self, request: Request) -> dict[str, Any]:
        pairs = self.session.pairs(request.changes, request.frame, tuple(range(DRAWS)))
        return {"images": [_pixels(_grey(pair.noisy)) for pair in pairs]}

    def server_close(self) -> None:
        """Close the server and the recording."""
        super().server_close()
        if self.real is not None:
            self.real.close()


def _grey(image: Array) -> UInt8s:
    """An image of a pair as 8 bits: uint8 as it is, float32 in 0..1 rounded."""
    if image.dtype == np.uint8:
        return np.asarray(image, np.uint8)
    return np.asarray(np.rint(np.asarray(image, np.float32) * 255), np.uint8)


def _shown(grey: UInt8s) -> dict[str, Any]:
    return {**_pixels(grey), "charts": charts_of(grey)._asdict()}


def _pixels(grey: UInt8s) -> dict[str, Any]:
    """An image for JSON: its size, and its grey values row by row in base 64."""
    height, width = grey.shape
    return {"height": height, "width": width, "grey": base64.b64encode(grey.tobytes()).decode()}


def _drawn(pair: Pair) -> dict[str, float]:
    """What was drawn for this pair, by the keys of the parameters."""
    return {
        key: round(float(value), 6)
        for key, value in pair.record.items()
        if isinstance(value, int | float | np.number) and np.isfinite(value)
    }
