"""A vehicle that keeps 2 m above the seabed by the image of its own sonar.

python examples/keep_altitude.py [PINGS] [FOLDER]

The sonar looks 35 degrees down and ahead.  In each ping the vehicle looks for the first echo in the
middle beams: there the lower edge of the beam meets the ground.  It remembers how high the ground
is at that place, and has sailed over it seconds later.  A proportional controller with a limit of
speed turns the height over the remembered ground into heave.
FOLDER gets altitude.csv and altitude.png (which needs matplotlib).
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
RUN = 3
# The two-way beam still hears the ground this far beyond the half of its opening.
EDGE_DEG = 14.0
WORDS = (
    "sonar.range.min_m=0.5", "sonar.range.max_m=10", "sonar.image.layout=polar",
    f"sonar.tilt_deg={TILT_DEG:g}", f"sonar.altitude_m={WANTED_M + 0.6:g}",
    "scenes.first_location=4", "sonar.range_bins=256", "scenes.width=320", "scenes.height=200",
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
    """Time, altitude by the image and true altitude of each ping; and the last ping."""
    edge_rad = np.deg2rad(TILT_DEG + EDGE_DEG)
    places_m = []
    ground_m = []
    heave_m = 0.0
    rows = []
    with Sonar("seabed", sonar="oculus_c550d_hf", seed=1, overrides=WORDS) as sonar:
        for index in range(pings):
            surge_m = index * SPEED_M_S / RATE_HZ
            ping = sonar.ping(Pose(surge_m=surge_m, heave_m=heave_m), index=index)
            range_m = first_echo_m(ping)
            if range_m is not None:
                places_m.append(surge_m + range_m * np.cos(edge_rad))
                ground_m.append(heave_m - range_m * np.sin(edge_rad))
            altitude_m = heave_m - ground_below_m(surge_m, places_m, ground_m)
            rows.append((index / RATE_HZ, altitude_m, float(ping.world["sonar.altitude_m"])))
            speed = np.clip(GAIN_PER_S * (WANTED_M - altitude_m), -HEAVE_LIMIT_M_S, HEAVE_LIMIT_M_S)
            heave_m += float(speed) / RATE_HZ
    return rows, ping


def ground_below_m(surge_m, places_m, ground_m):
    """Height of the ground that was seen nearest to a place: the median of nine echoes."""
    nearest = np.argsort(np.abs(np.array(places_m) - surge_m))[:9]
    return float(np.median(np.array(ground_m)[nearest]))


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
