"""What denoising and simulated targets are worth for a small classifier of real sonar targets.

python examples/nksid_classifier.py NKSID [SIMULATED]

NKSID: the folder of NK-Sonar-Image-Dataset (five classes of crops of an Oculus M750d; MIT, (c) 2023
Wenpei Jiao).  SIMULATED: a dataset with boxes of the same targets:

    python examples/make_targets.py targets
    simnfnd make experiment=physical scenes=seabed +scenes/objects=nksid sonar=oculus_m750d_hf \
        scenes.locations=60 scenes.frames_per_location=3 render=embree dataset.columns=[boxes] \
        dataset.dir=outputs/targets

Prints the macro-F1 of five folds, for three seeds.  Crops that look alike are frames of one pass
and stay in one fold; without that a classifier is tested on near copies of what it learned.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import torch
from scipy.sparse.csgraph import connected_components
from torch import nn

from simnfnd import denoise

CLASSES = ("big_propeller", "cylinder", "fishing_net", "small_propeller", "soft_pipeline")
SIDE_PX = 32
ALIKE = 0.8  # correlation of crops from which on they count as near-duplicates
LEAST_INSONIFIED = 0.2  # part of an object's outline that echoes in a simulated crop
FOLDS = 5
SEEDS = 3  # trainings of each network; their scores differ
EPOCHS = 20


def read_recorded(folder: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """Crops (h, w) uint8, and the class number of each."""
    crops = []
    labels = []
    for number, name in enumerate(CLASSES):
        for path in sorted((folder / name).glob("*.jpg")):
            crops.append(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            labels.append(number)
    return crops, np.array(labels)


def read_simulated(folder: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """The same of the boxes in a dataset of fan images."""
    crops = []
    labels = []
    for path in sorted(folder.glob("*/shard-*.h5")):
        with h5py.File(path) as shard:
            for number, row in enumerate(shard["meta"]):
                image = shard["noisy"][number]
                for box in json.loads(row["boxes"]):
                    if box["class"] in CLASSES and box["insonified"] > LEAST_INSONIFIED:
                        crop = cut_box(image, row, box)
                        if min(crop.shape) >= 8:
                            crops.append(crop)
                            labels.append(CLASSES.index(box["class"]))
    return crops, np.array(labels, int)


def cut_box(image: np.ndarray, row: np.void, box: dict) -> np.ndarray:
    """The part of a fan image that shows a box, with a margin of a sixth."""
    bearing_rad = np.deg2rad(np.linspace(*box["bearing_deg"], 20))
    range_m = np.array(box["range_m"])[:, None]
    # The sonar is below the middle of the image, whose top is the far end of its range.
    column = image.shape[1] / 2 + range_m * np.sin(bearing_rad) / row["metres_per_pixel"]
    line = (row["range_max_m"] - range_m * np.cos(bearing_rad)) / row["metres_per_pixel"]
    limits = []
    for places in (line, column):
        margin = (places.max() - places.min()) / 6 + 2
        limits.append(slice(max(0, int(places.min() - margin)), int(places.max() + margin)))
    crop = image[tuple(limits)]
    return crop if crop.dtype == np.uint8 else np.uint8(np.rint(255 * crop))


def normalise(crops: list[np.ndarray]) -> np.ndarray:
    """(N, 32, 32) float32 of mean 0 and deviation 1."""
    images = [cv2.resize(crop, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA) for crop in crops]
    images = np.float32(images)
    images -= images.mean(axis=(1, 2), keepdims=True)
    return images / (images.std(axis=(1, 2), keepdims=True) + 1e-3)


def group_alike(images: np.ndarray) -> np.ndarray:
    """Group number of each image: near-duplicates and what they are linked to by others."""
    pixels = images.reshape(len(images), -1)  # of mean 0
    pixels = pixels / (np.linalg.norm(pixels, axis=1, keepdims=True) + 1e-9)
    correlation = pixels @ pixels.T
    return connected_components(correlation > ALIKE)[1]


def split_folds(groups: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Fold of each image: whole groups, the largest first, to the fold that lacks their classes."""
    folds = np.zeros(len(groups), int)
    counts = np.zeros((FOLDS, len(CLASSES)))
    wanted = np.bincount(labels, minlength=len(CLASSES)) / FOLDS
    for group in sorted(set(groups), key=lambda group: -np.sum(groups == group)):
        members = groups == group
        added = np.bincount(labels[members], minlength=len(CLASSES))
        fold = int(np.argmin(((counts + added) / wanted).max(axis=1) + 0.01 * counts.sum(axis=1)))
        folds[members] = fold
        counts[fold] += added
    return folds


def train(images: np.ndarray, labels: np.ndarray, seed: int) -> nn.Module:
    """A small convolutional network; classes are drawn equally often."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    layers: list[nn.Module] = []
    for before, after in ((1, 8), (8, 16), (16, 32)):
        layers += [nn.Conv2d(before, after, 3, padding=1), nn.BatchNorm2d(after), nn.ReLU()]
        layers.append(nn.MaxPool2d(2))
    network = nn.Sequential(
        *layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Dropout(0.3), nn.Linear(32, len(CLASSES))
    )
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=1e-2)
    odds = 1 / np.bincount(labels)[labels]
    odds /= odds.sum()
    for _ in range(EPOCHS * len(images) // 32):
        chosen = rng.choice(len(images), 32, p=odds)
        batch = torch.from_numpy(images[chosen])[:, None]
        if rng.random() < 0.5:
            batch = batch.flip(-1)
        batch = torch.roll(batch, tuple(rng.integers(-4, 5, 2)), dims=(2, 3))
        loss = nn.functional.cross_entropy(network(batch), torch.from_numpy(labels[chosen]))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return network.eval()


def predict(network: nn.Module, images: np.ndarray) -> np.ndarray:
    """Class number of each image."""
    with torch.inference_mode():
        return network(torch.from_numpy(images)[:, None]).argmax(1).numpy()


def macro_f1(labels: np.ndarray, predicted: np.ndarray) -> float:
    """Mean over the classes of `labels` of the harmonic mean of precision and recall."""
    scores = []
    for number in np.unique(labels):
        hits = np.sum((labels == number) & (predicted == number))
        scores.append(2 * hits / (np.sum(labels == number) + np.sum(predicted == number)))
    return float(np.mean(scores))


def cross_validate(
    images: np.ndarray,
    labels: np.ndarray,
    folds: np.ndarray,
    seed: int,
    more: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Class number of each image by a network that saw the other folds.

    more: images and labels that every network learns from besides.
    """
    predicted = np.zeros_like(labels)
    for fold in range(FOLDS):
        learning = folds != fold
        fold_images = images[learning]
        fold_labels = labels[learning]
        if more is not None:
            fold_images = np.concatenate([fold_images, more[0]])
            fold_labels = np.concatenate([fold_labels, more[1]])
        network = train(fold_images, fold_labels, seed=FOLDS * seed + fold)
        predicted[~learning] = predict(network, images[~learning])
    return predicted


def print_scores(
    name: str, labels: np.ndarray, predict_with_seed: Callable[[int], np.ndarray]
) -> None:
    """A line of the macro-F1 of each seed, over the classes that occur, and their mean."""
    scores = [macro_f1(labels, predict_with_seed(seed)) for seed in range(SEEDS)]
    listed = ", ".join(f"{score:.3f}" for score in scores)
    print(f"{name}: macro-F1 {np.mean(scores):.3f} ({listed})", flush=True)


def main() -> None:
    """Print a line for each kind of training images."""
    torch.set_num_threads(1)
    crops, labels = read_recorded(Path(sys.argv[1]))
    recorded = normalise(crops)
    denoised = normalise([denoise(crop) for crop in crops])
    groups = group_alike(recorded)
    folds = split_folds(groups, labels)
    print(f"{len(crops)} crops in {len(set(groups))} groups of near-duplicates, {FOLDS} folds")
    print_scores("recorded", labels, lambda seed: cross_validate(recorded, labels, folds, seed))
    print_scores("denoised", labels, lambda seed: cross_validate(denoised, labels, folds, seed))
    if len(sys.argv) == 2:
        return

    crops, simulated_labels = read_simulated(Path(sys.argv[2]))
    simulated = normalise(crops)
    counts = np.bincount(simulated_labels, minlength=len(CLASSES))
    listed = ", ".join(f"{name} {count}" for name, count in zip(CLASSES, counts, strict=True))
    print(f"{len(simulated)} simulated crops: {listed}")
    more = (simulated, simulated_labels)
    print_scores(
        "recorded and simulated",
        labels,
        lambda seed: cross_validate(recorded, labels, folds, seed, more),
    )
    # A network of simulated crops alone is not asked about classes that were not simulated.
    known = np.isin(labels, simulated_labels)
    print_scores(
        "simulated alone",
        labels[known],
        lambda seed: predict(train(simulated, simulated_labels, seed), recorded[known]),
    )


main()
