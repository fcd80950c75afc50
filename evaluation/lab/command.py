"""`simnfnd lab`: what its words mean, and its page until Ctrl-C."""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.dataset.manifest import MANIFEST_NAME
from ...factory.simulation.config.key_help import choices_of
from ..viewer.page_server import add_page_options
from .server import LabServer
from .session import Session
from .stored_words import words_of_dataset

_DEFAULT = "experiment=physical"
_PARTS_OF_A_FRAME = 3


class PageSubject(NamedTuple):
    """What the page begins with.

    words: of `simnfnd make`.  real: the image or recording to compare with.
    frame: location/scene/frame; "" for the first.
    """

    words: list[str]
    real: Path | None
    frame: str


def main(words: list[str]) -> None:
    """Serve the page that `words` ask for until Ctrl-C."""
    parser = Parser(prog="simnfnd lab")
    parser.add_argument(
        "words",
        nargs="*",
        metavar="WORD",
        help="a device (sonar=DEVICE), a dataset, a frame (location/scene/frame), an image or "
        "recording to compare with, and KEY=VALUE as for `simnfnd make`; by default "
        f"{_DEFAULT}",
    )
    add_page_options(parser)
    options = parser.parse_intermixed_args(words)
    subject = read_words(options.words)
    session = Session(subject.words)
    frame = session.frame(subject.frame) if subject.frame else 0
    with LabServer(session, subject.real, frame, options.port) as server:
        server.serve_until_interrupted(opens_browser=not options.no_browser)


def read_words(words: Sequence[str]) -> PageSubject:
    """Sort words by what they name.

    Raises FactoryError, one line, for a word that names nothing, or one kind of thing twice.
    """
    settings = [word for word in words if _is_setting(word)]
    devices = choices_of("sonar")
    named: dict[str, str] = {}
    for word in words:
        if word in settings:
            continue
        kind = _kind_of(word, devices)
        if kind in named:
            raise FactoryError(f"{word}: the {kind} is {named[kind]} already; give one")
        named[kind] = word

    has_experiment = any(word.startswith("experiment=") for word in settings)
    if "dataset" in named:
        start = words_of_dataset(Path(named["dataset"]))
    elif has_experiment or (settings and "device" not in named):
        start = []
    else:
        start = [_DEFAULT]
    if "device" in named:
        start = [word for word in start if not word.startswith("sonar")]
        start.append(f"sonar={named['device']}")
    real = Path(named["image"]) if "image" in named else None
    return PageSubject([*start, *settings], real, named.get("frame", ""))


def _is_setting(word: str) -> bool:
    """Whether a word is KEY=VALUE, and not the name of a file or folder that has an `=`."""
    # Unlike Path.exists, os.path.exists takes a setting that is longer than any name.
    return "=" in word and not os.path.exists(Path(word).expanduser())


def _kind_of(word: str, devices: Sequence[str]) -> str:
    path = Path(word).expanduser()
    if os.path.isfile(path / MANIFEST_NAME):
        return "dataset"
    if os.path.exists(path):
        return "image"
    if word in devices:
        return "device"
    if len(word.split("/")) == _PARTS_OF_A_FRAME:
        return "frame"
    near = difflib.get_close_matches(word, devices, n=2)
    hint = f"did you mean {' or '.join(near)}?" if near else "`simnfnd lab --help` says what may be"
    raise FactoryError(f"{word}: no device, dataset, frame, image or recording; {hint}")
