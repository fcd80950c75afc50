"""`simnfnd stream`: a sonar sails along a trajectory, and its pings go into an MCAP file."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from ...common.command_line import Parser
from ...common.errors import FactoryError
from ...simulation.pings.sonar import Sonar
from ...simulation.pings.trajectories import TimedPose, poses_of

_BEGIN_S = 946_684_800.0
"""Time stamp of the first ping, 2000-01-01: undated bags begin at 0."""
_REPORT_EVERY_S = 1.0


def main(words: list[str]) -> None:
    """Sail the trajectory.  Raises FactoryError."""
    parser = Parser(prog="simnfnd stream")
    parser.add_argument(
        "--path", default="line", help="line, circle, lawnmower, or a CSV file of poses (line)"
    )
    parser.add_argument("--out", required=True, help="folder of the recording, which is made")
    parser.add_argument("--count", type=int, default=100, help="pings along a shape (100)")
    parser.add_argument("--rate", type=float, default=10.0, help="pings a second (10)")
    parser.add_argument("--speed", type=float, default=0.5, help="along a shape, m/s (0.5)")
    parser.add_argument(
        "--realtime", action="store_true", help="ping at the rate, and miss pings that come late"
    )
    parser.add_argument("--only-images", action="store_true", help="without points and labels")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for `simnfnd make`")
    options = parser.parse_intermixed_args(words)
    for name, value in (("--count", options.count), ("--rate", options.rate)):
        if value <= 0:
            raise FactoryError(f"{name}={value:g}: must be above 0")
    folder = Path(options.out).expanduser()
    if folder.exists():
        raise FactoryError(f"--out={options.out}: is there already; name a new folder")

    scenes = [word for word in options.settings if word.startswith("scenes=")]
    scene = scenes[-1].partition("=")[2] if scenes else "seabed"
    overrides = [word for word in options.settings if not word.startswith("scenes=")]
    if scene == "seabed":
        overrides.insert(0, f"scenes.frame_rate_hz={options.rate:g}")
    poses = poses_of(
        options.path, scene, count=options.count, rate_hz=options.rate, speed_m_s=options.speed
    )
    with Sonar(scene, overrides=overrides) as sonar:
        report = sail(
            sonar, poses, folder, in_real_time=options.realtime, only_images=options.only_images
        )
    print(f"{folder}: {report}")


class Progress:
    """Rate, latency and missed pings of a run, as a line on stderr every second."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._began_s = self._said_s = time.monotonic()
        self._took_s: list[float] = []
        self._missed = 0

    def miss(self) -> None:
        """Count a ping that was not made in time."""
        self._missed += 1

    def add(self, took_s: float) -> None:
        """Count a ping, and say so from time to time."""
        self._took_s.append(took_s)
        now_s = time.monotonic()
        if now_s - self._said_s >= _REPORT_EVERY_S:
            self._said_s = now_s
            print(str(self), file=sys.stderr)

    def __str__(self) -> str:
        done = len(self._took_s)
        rate_hz = done / max(time.monotonic() - self._began_s, 1e-9)
        slow_ms = 1000 * float(np.percentile(self._took_s, 95)) if done else 0.0
        return (
            f"{done} of {self._total} pings, {rate_hz:.1f} Hz, 95 % within {slow_ms:.0f} ms, "
            f"{self._missed} missed"
        )


def sail(
    sonar: Sonar,
    poses: list[TimedPose],
    folder: Path,
    *,
    in_real_time: bool = False,
    only_images: bool = False,
) -> str:
    """Write the pings at these poses into an MCAP file; returns what became of them.

    in_real_time: ping when the time of a pose has come, and leave out poses whose successor's time
        has come, too.
    """
    from ..export.ping_messages import PingMessages
    from ..export.ros_messages import Bag

    progress = Progress(len(poses))
    with Bag(folder) as bag:
        messages = PingMessages(sonar, bag.types, only_images=only_images)
        sonar.ping(poses[0].pose).polar  # noqa: B018 - the scene is ready when the clock starts
        began_s = time.monotonic()
        for index, (time_s, pose) in enumerate(poses):
            if in_real_time:
                passed_s = time.monotonic() - began_s
                if index + 1 < len(poses) and passed_s >= poses[index + 1].time_s:
                    progress.miss()
                    continue
                time.sleep(max(time_s - passed_s, 0.0))
            start_s = time.monotonic()
            stamp_s = _BEGIN_S + time_s
            bag.write(stamp_s, messages.of(sonar.ping(pose, index=index, time_s=time_s), stamp_s))
            progress.add(time.monotonic() - start_s)
    return str(progress)
