"""What moving objects cost: CPU milliseconds of a frame of `experiment=fish` with ten and without.

The static render is at hand, as for every frame of a sonar at rest but the first.
"""

from __future__ import annotations

from benchmarks.shared import Options, Section, Table, cpu_seconds
from simnfnd.factory.common.workers.machine import keep_freed_memory
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.renderer_choice import renderer_of
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.views import Views
from simnfnd.factory.simulation.render import open_renderer
from simnfnd.factory.simulation.render.view import view_of
from simnfnd.factory.simulation.scenes import open_reader

REPEATS = 9
OBJECTS = 10

# A school in the middle of the fan, so that all of it is seen.
_SCHOOL = (
    "{object: Fish, length_m: {uniform: [0.12, 0.35]}, moving: {speed_m_s: 0.2, "
    "heading_deg: {uniform: [-180, 180]}, height_m: {uniform: [0.2, 0.5]}, "
    "start: {range_m: 5, bearing_deg: 0}, target_strength: love, "
    f"school: {{count: {OBJECTS}, spread_m: 0.4}}}}}}"
)
_IMAGE_ALONE = ("dataset.layers=[]", "dataset.columns=[pose]")
_LABELLED = ("dataset.layers=[static]", "dataset.columns=[pose,tracks]")


def measure(options: Options) -> Section:
    """A row for a frame without moving objects, with them, and with their labels stored."""
    keep_freed_memory()
    repeats = options.amount(REPEATS)
    school = f"scenes.moving_objects=[{_SCHOOL}]"
    without_s = _frame_cpu_s(("scenes.moving_objects=[]", *_IMAGE_ALONE), repeats)
    with_s = _frame_cpu_s((school, *_IMAGE_ALONE), repeats)
    labelled_s = _frame_cpu_s((school, *_LABELLED), repeats)
    rows = (
        ("no moving object", 1000 * without_s, 1.0),
        (f"{OBJECTS} fish", 1000 * with_s, with_s / without_s),
        (
            f"{OBJECTS} fish, `static` and `tracks` stored",
            1000 * labelled_s,
            labelled_s / without_s,
        ),
    )
    return Section((Table(("frame", "CPU ms", "times"), rows),))


def _frame_cpu_s(words: tuple[str, ...], repeats: int) -> float:
    """CPU seconds of a pair whose render is at hand."""
    config = compose_config(["experiment=fish", *words])
    first, second = open_reader(config.scenes).discover().frames[:2]
    maker = PairMaker(config, _rendered(config, (first, second)))
    maker.pairs(first, (0,))
    return cpu_seconds(lambda: maker.pairs(second, (0,)), repeats)


def _rendered(config: FactoryConfig, refs: tuple[FrameRef, ...]) -> Views:
    """The renders of frames, in memory."""
    reader = open_reader(config.scenes)
    renderer = open_renderer(renderer_of(config).settings)
    views = {}
    for ref in refs:
        frame = reader.load(ref)
        views[ref] = view_of(frame, renderer.render(frame, config.sonar.mount), config.sonar.mount)
    return Views(views)
