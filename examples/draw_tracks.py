"""A recording of a dataset as an animation, with the tracks of moving objects.

python examples/draw_tracks.py outputs/fish fish.gif

Takes the recording with most moving echoes (a third word: that recording).  Left: the noisy frame
with the box, number and way of each object; right: the static scene.  A name that ends in .png
gets the middle frame alone.
"""

import sys

import cv2
import numpy as np
from PIL import Image

from simnfnd import FactoryError, PairDataset

COLOURS = [(255, 200, 90), (120, 255, 120), (120, 200, 255), (255, 140, 200), (255, 255, 130)]
FRAME_MS = 100


def echo_count(sequence):
    """How many echoes of moving objects a recording has."""
    return sum(track["box"] is not None for tracks in sequence.tracks for track in tracks)


def drawn(sequence, number):
    """A frame with its tracks so far, beside the static scene."""
    frame = cv2.cvtColor(sequence.noisy[number], cv2.COLOR_GRAY2RGB)
    for track in sequence.tracks[number]:
        if track["box"] is None:
            continue
        colour = COLOURS[track["id"] % len(COLOURS)]
        left, top, width, height = track["box"]
        cv2.rectangle(frame, (left - 2, top - 2), (left + width + 1, top + height + 1), colour, 1)
        cv2.putText(frame, str(track["id"]), (left, top - 5), 0, 0.35, colour, 1, cv2.LINE_AA)
        way = [
            (earlier["box"][0] + earlier["box"][2] // 2, earlier["box"][1] + earlier["box"][3] // 2)
            for tracks in sequence.tracks[: number + 1]
            for earlier in tracks
            if earlier["id"] == track["id"] and earlier["box"] is not None
        ]
        cv2.polylines(frame, [np.array(way, np.int32)], False, colour, 1, cv2.LINE_AA)
    static = cv2.cvtColor(sequence.static[number], cv2.COLOR_GRAY2RGB)
    return Image.fromarray(np.hstack([frame, static]))


if len(sys.argv) < 3:
    sys.exit(__doc__)
folder, out, *wanted = sys.argv[1:]
try:
    with PairDataset(folder, "all", layers=("noisy", "clean", "static")) as pairs:
        names = wanted or pairs.recordings.names
        sequence = max((pairs.sequence(name) for name in names), key=echo_count)
except FactoryError as error:
    sys.exit(str(error))
middle = len(sequence) // 2
if out.endswith(".png"):
    drawn(sequence, middle).save(out)
else:
    first, *others = (drawn(sequence, number) for number in range(len(sequence)))
    first.save(out, save_all=True, append_images=others, duration=FRAME_MS, loop=0)
print(f"{out}: {sequence.recording}, {len(sequence)} frames, {echo_count(sequence)} boxes")
