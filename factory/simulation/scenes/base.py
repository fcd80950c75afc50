"""What readers of RGBD recordings share: settings, what they find, and lists in text files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from typing import Annotated, Any, Literal, Protocol

from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

from ...common.errors import FactoryError
from ...common.settings import STRICT, ClassName
from ...dataset.frame_ref import FrameRef
from ..frames.frame import Frame

LONGEST_NAME = 88
"""Bytes of names that come from files: the sample table holds 96, and a number may follow."""
INTEGERS_PER_M = 1000.0
"""What integer depth is divided by where `depth_scale` is null: millimetres."""


def _required_path(root: str) -> str:
    # "???" is how the YAML files say that the user has to fill a key in.
    if root.strip() in ("", "???"):
        raise ValueError("a path is required, for example scenes.root=../data/flsea-vi")
    return root


Root = Annotated[str, AfterValidator(_required_path)]


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class OwnClass:
    """The properties of a class of objects that the user states.

    class: what it is called in labels; a name of `meaning.CLASSES`, or a new one.
    reflectivity_db, lambert_exponent: see `AcousticsSettings`; None: not said here.
    """

    label: Annotated[ClassName, Field(alias="class")]
    reflectivity_db: Annotated[float, Field(ge=-80, le=20)] | None = None
    lambert_exponent: Annotated[float, Field(ge=0, le=8)] | None = None


@dataclass(frozen=True, config=STRICT)
class SceneSettings:
    """The keys and answers that all `scenes` kinds have."""

    def own(self) -> tuple[OwnClass, ...]:
        """The classes of the user's own objects, and how they echo."""
        return ()

    def rendered_ref(self, ref: FrameRef) -> FrameRef:
        """The frame whose render a frame shares: itself, or the first one of a sonar at rest."""
        return ref

    def time_s(self, ref: FrameRef) -> float | None:
        """When a frame was taken, where the settings decide it."""
        return None

    @property
    def is_continuous(self) -> bool:
        """Whether the frames of a scene are pings of one device, one after another."""
        return False

    @property
    def start_s(self) -> float:
        """The time of the first frames, from which objects move."""
        return 0.0

    @property
    def has_moving_objects(self) -> bool:
        """Whether objects move through its recordings."""
        return False

    def own_classes(self) -> tuple[str, ...]:
        """Names of the user's own classes, beside `meaning.CLASSES` or among them."""
        return tuple(own_class.label for own_class in self.own())


BadDepth = Literal["reject", "mask"]
"""What NaN, infinite and negative depths mean: a bad frame, or an unmeasured pixel."""


@plain_dataclass(frozen=True)
class Discovery:
    """The frames that a reader found, and what it left out.

    frames: every usable frame, sorted by (location, scene, frame).
    skipped: reason -> how many images were left out for it (for example no depth map).
    notes: one-line remarks for the user (which scenes are absent, for example).
    """

    frames: tuple[FrameRef, ...]
    skipped: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def discovery(
    frames: Iterable[FrameRef],
    nothing: str,
    skipped: Mapping[str, int] | None = None,
    notes: Iterable[str] = (),
) -> Discovery:
    """The sorted frames and counts.  Raises FactoryError(nothing) where there is no frame."""
    ordered = sorted(frames, key=lambda ref: (ref.location, ref.scene, ref.frame))
    if not ordered:
        raise FactoryError(nothing)
    counts = {reason: count for reason, count in sorted((skipped or {}).items()) if count}
    return Discovery(tuple(ordered), counts, tuple(notes))


@dataclass(frozen=True, config=STRICT, kw_only=True)
class OwnSceneSettings(SceneSettings):
    """What the settings of a reader of another package are made of.

    kind: its name; the settings class narrows it to one, `kind: Literal["mine"] = "mine"`.
    """

    kind: str


def settings_fields(settings: type[OwnSceneSettings]) -> dict[str, FieldInfo]:
    """The keys of a settings class, as pydantic describes them."""
    described: dict[str, FieldInfo] = vars(settings)["__pydantic_fields__"]
    return described


@plain_dataclass(frozen=True)
class ReaderEntry:
    """A reader of another package.

    settings: a subclass of `OwnSceneSettings`.  reader: builds the reader from such settings.
    has_labels: whether its frames have segmentation and instance.
    """

    settings: type[OwnSceneSettings]
    reader: Callable[[Any], Reader]
    has_labels: bool = False

    @property
    def kind(self) -> str:
        """The name by which `scenes=KIND` chooses it."""
        return str(settings_fields(self.settings)["kind"].default)


class Reader(Protocol):
    """Finds frames and loads them.  Built from settings alone, so a worker can build its own."""

    def discover(self) -> Discovery:
        """List the frames.

        Raises FactoryError when the root is missing, cannot be read, or holds nothing of use.
        """

    def load(self, ref: FrameRef) -> Frame:
        """Read one frame, checked (`frame.checked`).  Raises FrameError when it is bad."""
