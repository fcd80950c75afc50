"""A vehicle that keeps 2 m above the seabed by the image of its own sonar.

python examples/keep_altitude.py [PINGS] [FOLDER]

The sonar looks 35 degrees down.  In each ping the vehicle looks for the first echo in the middle
beams, and takes the ground there for level: its altitude is the range times the sine of the angle
below the horizon at which the lower edge of the beam looks.  A proportional controller with a limit
of speed turns that into heave.  FOLDER gets altitude.csv and altitude.png (which needs matplotlib).
"""

import csv
import sys
from pathlib import Path

import numpy as np

from simnfnd import Pose, Sonar

WANTED_M = 2.0
RATE_HZ = 10.0
SPEED_M_S = 0.5
HEAVE_LIMIT_M_S = 0.3
GAIN_PER_S = 0.8
TILT_DEG = 35.0
# Grey values of the log display above haze and noise, and how many ranges in a row make an echo.
LOUD = 90
RUN = 6
# The two-way beam still hears the ground this far beyond the half of its opening.
EDGE_DEG = 14.0
WORDS = (
    "sonar.range.min_m=0.5", "sonar.range.max_m=10", "sonar.image.layout=polar",
    f"sonar.tilt_deg={TILT_DEG:g}", f"sonar.altitude_m={WANTED_M + 0.6:g}",
    "scenes.first_location=4",
)  # fmt: skip


def first_echo_m(ping):
    """Range of the first run of loud ranges in the middle beams, metres; None without one."""
    grey = ping.polar[:, 96:-96].astype(float)
    profile = np.median(grey, axis=1)
    loud = np.convolve(profile > LOUD, np.ones(RUN), "valid") == RUN
    if not loud.any():
        return None
    near_m = ping.geometry.range_min_m
    bin_m = (ping.geometry.range_max_m - near_m) / len(profile)
    return near_m + bin_m * int(loud.argmax())


def sail(pings):
    """Time, altitude by the image and true altitude of each ping."""
    heave_m = 0.0
    altitude_m = WANTED_M
    rows = []
    with Sonar("seabed", sonar="oculus_c550d_hf", seed=1, overrides=WORDS) as sonar:
        for index in range(pings):
            pose = Pose(surge_m=index * SPEED_M_S / RATE_HZ, heave_m=heave_m)
            ping = sonar.ping(pose, index=index)
            range_m = first_echo_m(ping)
            if range_m is not None:
                seen_m = range_m * np.sin(np.deg2rad(TILT_DEG + EDGE_DEG))
                altitude_m += 0.3 * (seen_m - altitude_m)
            rows.append((index / RATE_HZ, altitude_m, float(ping.world["sonar.altitude_m"])))
            speed = np.clip(GAIN_PER_S * (WANTED_M - altitude_m), -HEAVE_LIMIT_M_S, HEAVE_LIMIT_M_S)
            heave_m += float(speed) / RATE_HZ
    return rows, ping


def draw(rows, ping, path):
    """The altitudes over time beside the last ping's fan."""
    try:
        import matplotlib
    except ModuleNotFoundError:
        print("no picture: it needs matplotlib")
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot

    time_s, seen_m, true_m = np.array(rows).T
    figure, (left, right) = pyplot.subplots(
        1, 2, figsize=(10, 3.6), width_ratios=(3, 2), layout="constrained"
    )
    left.plot(time_s, true_m, label="altitude")
    left.plot(time_s, seen_m, linewidth=0.8, label="by the image")
    left.axhline(WANTED_M, color="grey", linewidth=0.8)
    left.set(xlabel="time, s", ylabel="m above the seabed", ylim=(0, 4))
    left.legend(loc="lower right")
    right.imshow(ping.fan, cmap="gray", vmin=0, vmax=255)
    right.set_axis_off()
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    pings = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    rows, last = sail(pings)
    with open(folder / "altitude.csv", "w", newline="") as file:
        csv.writer(file).writerows([("time_s", "by_image_m", "true_m"), *rows])
    draw(rows, last, folder / "altitude.png")
    off_m = np.abs(np.array(rows)[len(rows) // 5 :, 2] - WANTED_M)
    print(f"{pings} pings: off by {off_m.mean():.2f} m on average, {off_m.max():.2f} m at most")
