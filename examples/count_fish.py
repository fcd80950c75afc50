r"""Train a small detector on simulated fish, and count real ones with it.

simnfnd make experiment=fish sonar=didson_hf scenes.locations=6 scenes.frames_per_location=40 \
    dataset.dir=outputs/fish
python examples/count_fish.py outputs/fish [STEPS [FRAMES]]

STEPS: of the training, 500 unless given.  FRAMES: how many real frames are looked at, all unless
given.

The real fish are those of didson/lamprey1.avi, whose 150 frames are labelled in
didson/lamprey1-fish.csv.  The rival is background subtraction: the brightest peaks of a frame minus
the background of its recording.  Both find their threshold on simulated recordings held out from
training; no real frame and no label is read before the last step.

lamprey1 is no fresh test, though: `noise=recording` and the sidelobes of `experiment=fish` were set
beside it, the scale of its frames was chosen by looking at it, and `ZOOM` after a first training
had been tried on it.
"""

import csv
import sys
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional

from simnfnd import FactoryError, PairDataset, open_recording

EXAMPLE = Path(__file__).resolve().parent / "didson" / "lamprey1.avi"
LABELS = EXAMPLE.with_name("lamprey1-fish.csv")

WINDOW = 5  # frames that the network sees
HELD_OUT = 1 / 3  # of the simulated recordings, which do not train
HELD_OUT_STEP = 8  # every n-th of their frames is looked at
BATCH = 8
CROP_PX = 64
ZOOM = 1.0, 2.0  # simulated fish are smaller than those of lamprey1
POSITIVE = torch.tensor(3.0)  # weight of a fish in the loss
LEAST_CONTRAST = 10 / 255  # of a simulated echo that counts as visible
MATCH_PX = 5  # from a detection to the box of its fish
APART_PX = 9  # between detections
# Of a track that counts:
JUMP_PX = 12
GAP_FRAMES = 5
LEAST_DETECTIONS = 10


class Peak(NamedTuple):
    """A detection: a pixel and how sure the detector is."""

    x: int
    y: int
    score: float


class Fish(NamedTuple):
    """A labelled fish in one frame: its box in pixels, and whether an eye is sure of it."""

    number: int
    left: float
    top: float
    width: float
    height: float
    is_plain: bool

    def distance_px(self, peak: Peak) -> float:
        """From a detection to the box, 0 inside."""
        beside = max(self.left - peak.x, 0, peak.x - self.left - self.width)
        above = max(self.top - peak.y, 0, peak.y - self.top - self.height)
        return float(np.hypot(beside, above))


class Recording(NamedTuple):
    """deviations: (T, H, W) float32, frames minus background in standard deviations of the grain.

    fish: T lists.
    """

    deviations: np.ndarray
    fish: list[list[Fish]]


# --- recordings


def registered(frames):
    """Frames shifted by whole pixels onto the first, (T, H, W) float32."""
    fade = cv2.createHanningWindow(frames[0].shape[::-1], cv2.CV_32F)
    first = frames[0].astype(np.float32)
    shifted = []
    for frame in frames.astype(np.float32):
        (right, down), _ = cv2.phaseCorrelate(first, frame, fade)
        shifted.append(np.roll(frame, (-round(down), -round(right)), (0, 1)))
    return np.stack(shifted)


def deviations_of(frames):
    """Registered frames minus their median over time, over the standard deviation of the grain."""
    frames = registered(frames)
    change = frames - np.median(frames, axis=0)
    spread = 1.48 * np.median(np.abs(change), axis=0)
    spread = np.maximum(cv2.GaussianBlur(spread, (0, 0), 4), 1)
    is_insonified = cv2.GaussianBlur(np.median(frames, axis=0), (0, 0), 3) > 4
    return np.where(is_insonified, change / spread, 0).astype(np.float32)


def simulated(folder):
    """All recordings of a dataset of fish."""
    with PairDataset(folder, "all", layers=("noisy", "clean", "static")) as pairs:
        sequences = [pairs.sequence(name) for name in sorted(pairs.recordings.names)]
    recordings = []
    for sequence in sequences:
        contrast = np.abs(sequence.clean.astype(np.float32) - sequence.static) / 255
        fish = [
            [
                Fish(track["id"], *track["box"], is_plain=True)
                for track in tracks
                if track["box"] is not None and is_visible(contrast[number], track["box"])
            ]
            for number, tracks in enumerate(sequence.tracks)
        ]
        recordings.append(Recording(deviations_of(sequence.noisy), fish))
    return recordings


def is_visible(contrast, box):
    """Whether an echo changes the clean image anywhere in its box."""
    left, top, width, height = box
    return contrast[top : top + height, left : left + width].max() > LEAST_CONTRAST


def real(count=None):
    """The first frames of lamprey1 (all: None) at half their size, for its fish are large."""
    with open_recording(EXAMPLE) as recording:
        frames = np.stack([shot.frame.samples for shot in islice(recording, count)])
    if frames.ndim == 4:
        frames = frames[..., 0]
    half = [
        cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for frame in frames
    ]
    fish = [[] for _ in frames]
    with LABELS.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            number = int(row["frame"])
            if number < len(frames):
                box = [int(row[key]) / 2 for key in ("x", "y", "w", "h")]
                fish[number].append(Fish(int(row["id"]), *box, row["visible"] == "1"))
    return Recording(deviations_of(np.stack(half)), fish)


# --- network


def block(inputs, outputs, kernel, **keywords):
    """A convolution, normalised and rectified."""
    convolution = nn.Conv2d(inputs, outputs, kernel, bias=False, **keywords)
    return [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]


def build_network(width=32):
    """(N, WINDOW, H, W) deviations -> (N, 1, H, W) logits: is a fish's middle here?"""
    layers = block(WINDOW, width, 5, stride=2, padding=2)
    for dilation in (1, 2, 4, 2, 1):
        layers += block(width, width, 3, padding=dilation, dilation=dilation)
    last = nn.Conv2d(width, 1, 3, padding=1)
    nn.init.constant_(last.bias, -4.0)  # fish are rare
    return nn.Sequential(*layers, last, nn.Upsample(scale_factor=2, mode="bilinear"))


def window(deviations, middle):
    """(WINDOW, H, W) frames around one; at the ends of a recording its last frame is repeated."""
    frames = np.arange(middle - WINDOW // 2, middle + WINDOW // 2 + 1)
    return deviations[np.clip(frames, 0, len(deviations) - 1)].clip(-8, 16) / 4


def heat_of(fish, top, left, size):
    """(size, size) 1 at the middle of each fish, falling off as its box is wide and high."""
    rows, columns = np.indices((size, size), np.float32)
    heat = np.zeros((size, size), np.float32)
    for label in fish:
        across = columns + left - label.left - label.width / 2
        along = rows + top - label.top - label.height / 2
        distance = np.hypot(across / max(label.width / 4, 1.5), along / max(label.height / 4, 1.5))
        heat = np.maximum(heat, np.exp(-(distance**2) / 2))
    return heat


def sample(recording, rng):
    """A square of a window and its heat, half of them around a fish, mirrored and of any size."""
    middle = int(rng.integers(len(recording.deviations)))
    fish = recording.fish[middle]
    height, width = recording.deviations.shape[1:]
    size = int(CROP_PX / rng.uniform(*ZOOM))
    top = int(rng.integers(height - size))
    left = int(rng.integers(width - size))
    if fish and rng.random() < 0.5:
        chosen = fish[rng.integers(len(fish))]
        top = int(np.clip(chosen.top - rng.integers(size), 0, height - size))
        left = int(np.clip(chosen.left - rng.integers(size), 0, width - size))
    frames = window(recording.deviations[:, top : top + size, left : left + size], middle)
    frames = frames * rng.uniform(0.6, 1.3)
    layers = [*frames, heat_of(fish, top, left, size)]
    stack = np.stack([cv2.resize(layer, (CROP_PX, CROP_PX)) for layer in layers])
    if rng.random() < 0.5:
        stack = stack[:, :, ::-1]
    return stack.astype(np.float32)


def train(network, recordings, steps):
    """Cross entropy of heatmaps; fish weigh more, for they are rare."""
    rng = np.random.default_rng(0)
    optimizer = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 5e-3, total_steps=steps)
    network.train()
    losses = []
    for step in range(1, steps + 1):
        chosen = rng.integers(len(recordings), size=BATCH)
        batch = torch.from_numpy(np.stack([sample(recordings[k], rng) for k in chosen]))
        heat = batch[:, WINDOW:]
        logits = network(batch[:, :WINDOW])
        loss = functional.binary_cross_entropy_with_logits(logits, heat, pos_weight=POSITIVE)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
        if step % 50 == 0:
            print(f"step {step}: loss {np.mean(losses[-50:]):.4f}", flush=True)
    network.eval()


# --- detections


def network_scores(network, recording, step=1):
    """(T, H, W) how sure the network is of a fish's middle in each pixel of every step-th frame."""
    scores = []
    for middle in range(0, len(recording.deviations), step):
        frames = torch.from_numpy(window(recording.deviations, middle))
        with torch.no_grad():
            logits = network(frames[None])[0, 0, : frames.shape[1], : frames.shape[2]]
        scores.append(torch.sigmoid(logits).numpy())
    return np.stack(scores)


def subtraction_scores(recording, step=1):
    """(T, H, W) the deviation of each pixel, blurred as the grain is wide."""
    return np.stack(
        [cv2.GaussianBlur(frame, (0, 0), 1.5) for frame in recording.deviations[::step]]
    )


def peaks(scores, least):
    """Local maxima of one frame from a score on, the highest first."""
    kernel = np.ones((2 * APART_PX + 1,) * 2, np.uint8)
    rows, columns = np.nonzero((scores >= least) & (scores == cv2.dilate(scores, kernel)))
    maxima = [Peak(int(x), int(y), float(scores[y, x])) for y, x in zip(rows, columns, strict=True)]
    return sorted(maxima, key=lambda peak: -peak.score)


def above(detections, least):
    """The detections of each frame from a score on."""
    return [[peak for peak in frame if peak.score >= least] for frame in detections]


class Tally(NamedTuple):
    """Detections of fish, detections of nothing, and fish that were not detected."""

    hits: int
    false: int
    missed: int

    @property
    def precision(self):
        """Part of the detections that are fish."""
        return self.hits / max(self.hits + self.false, 1)

    @property
    def recall(self):
        """Part of the fish that were detected."""
        return self.hits / max(self.hits + self.missed, 1)

    @property
    def f1(self):
        """The harmonic mean of both."""
        return 2 * self.hits / max(2 * self.hits + self.false + self.missed, 1)


def judge(detections, fish):
    """Detections a frame against its labels; those of doubtful fish count for nothing."""
    hits = false = missed = 0
    for frame, labels in zip(detections, fish, strict=True):
        waiting = list(labels)
        for peak in frame:
            nearest = min(waiting, key=lambda label: label.distance_px(peak), default=None)
            if nearest is None or nearest.distance_px(peak) > MATCH_PX:
                false += 1
                continue
            waiting.remove(nearest)
            hits += nearest.is_plain
        missed += sum(label.is_plain for label in waiting)
    return Tally(hits, false, missed)


def count_tracks(detections):
    """How many fish pass: detections linked to the nearest of the frames before."""
    tracks = []
    for number, frame in enumerate(detections):
        for peak in frame:
            nearest = None
            distance_px = JUMP_PX
            for track in tracks:
                last, last_number = track[-1]
                apart_px = np.hypot(last.x - peak.x, last.y - peak.y)
                if 0 < number - last_number <= GAP_FRAMES and apart_px < distance_px:
                    nearest = track
                    distance_px = apart_px
            if nearest is None:
                tracks.append([(peak, number)])
            else:
                nearest.append((peak, number))
    return sum(len(track) >= LEAST_DETECTIONS for track in tracks)


def compare(name, score, candidates, held, lamprey):
    """Choose a threshold on simulated recordings, and print what it finds in both kinds."""
    simulated_peaks = []
    simulated_fish = []
    for recording in held:
        scores = score(recording, HELD_OUT_STEP)
        simulated_peaks += [peaks(frame, candidates[0]) for frame in scores]
        simulated_fish += recording.fish[::HELD_OUT_STEP]
    least = max(candidates, key=lambda low: judge(above(simulated_peaks, low), simulated_fish).f1)
    real_peaks = above([peaks(frame, least) for frame in score(lamprey)], least)
    for place, detections, fish in (
        ("simulated", above(simulated_peaks, least), simulated_fish),
        ("lamprey1", real_peaks, lamprey.fish),
    ):
        tally = judge(detections, fish)
        print(f"{name}, {place}: precision {tally.precision:.2f}, recall {tally.recall:.2f}")
    print(f"{name}: {count_tracks(real_peaks)} fish counted in lamprey1 (threshold {least:.2f})")


def main():
    """Train, choose thresholds, and compare with the rival on simulated and on real fish."""
    folder = sys.argv[1]
    steps = int(sys.argv[2]) if len(sys.argv) > 2 else 500
    real_frames = int(sys.argv[3]) if len(sys.argv) > 3 else None
    torch.manual_seed(0)
    recordings = simulated(folder)
    count = max(1, round(HELD_OUT * len(recordings)))
    learning = recordings[:-count]
    held = recordings[-count:]
    network = build_network()
    print(f"{sum(weight.numel() for weight in network.parameters())} parameters")
    train(network, learning, steps)

    lamprey = real(real_frames)
    labels = [label for frame in lamprey.fish for label in frame]
    numbers = {label.number for label in labels}
    plain = sum(label.is_plain for label in labels)
    print(f"lamprey1: {len(numbers)} fish, {plain} plain boxes, {len(lamprey.fish)} frames")
    compare("background subtraction", subtraction_scores, np.arange(1, 8, 0.25), held, lamprey)
    by_network = partial(network_scores, network)
    compare("network", by_network, np.arange(0.05, 1, 0.05), held, lamprey)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    try:
        main()
    except FactoryError as error:
        sys.exit(str(error))
