"""Components of similarity, folds that keep them whole, and labels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.evaluation.downstream.components import components, similarity
from simnfnd.evaluation.downstream.report import about_components, counted_classes
from simnfnd.evaluation.downstream.splits import folds_of, labelled_of
from simnfnd.evaluation.downstream.trainings import planned
from simnfnd.factory.errors import FactoryError
from simnfnd.models.recordings import PICTURE_SUFFIXES
from tests.project_files import ROOT

Array = npt.NDArray[Any]
MDD = ROOT.parent / "shared" / "data" / "mdd"


def scene(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    rough = cv2.GaussianBlur(rng.normal(size=(160, 120)), (0, 0), 6)
    return np.asarray(0.4 + 0.1 * rough / rough.std(), np.float32)


def seen(place: Array, seed: int, shift: int = 0) -> Array:
    """A look at a scene: shifted, with speckle, under a fan's outline."""
    speckle = np.random.default_rng(seed).gamma(6, 1 / 6, place.shape)
    picture = np.roll(place, shift, axis=1) * speckle
    picture[:, :20] = picture[:, -20:] = 0
    return np.asarray(np.clip(picture, 0, 1), np.float32)


def test_looks_at_one_scene_are_one_component() -> None:
    """However they are shuffled, shifted by some pixels, and whatever the speckle."""
    first, second, third = (scene(seed) for seed in range(3))
    images = [seen(second, 10), seen(first, 11), seen(third, 12), seen(first, 13, 9)]
    images += [seen(second, 14, -6), seen(first, 15)]
    alike = similarity(images)
    np.testing.assert_array_equal(alike, alike.T)
    np.testing.assert_array_equal(np.diag(alike), 1)
    np.testing.assert_array_equal(components(alike > 0.5), [1, 0, 2, 0, 1, 0])


def test_components_are_chains() -> None:
    """The third is like the second alone, and in the component of the first all the same."""
    alike = np.eye(5, dtype=np.bool_)
    for one, other in ((1, 3), (3, 4)):
        alike[one, other] = alike[other, one] = True
    found = components(alike)
    np.testing.assert_array_equal(found, [1, 0, 2, 0, 0])
    told = about_components(found, 0.5)
    assert told == (
        "5 pictures in 3 components of similarity (alike=0.5), of 3, 1 (2 times) pictures"
    )


def test_no_component_is_on_both_sides() -> None:
    rng = np.random.default_rng(0)
    component = components(np.eye(90, dtype=np.bool_))
    component = np.where(rng.random(90) < 0.5, component % 7, component)
    component = np.unique(component, return_inverse=True)[1]
    for seed in range(5):
        fold = folds_of(component, 3, seed)
        for one in np.unique(component):
            assert len(set(fold[component == one])) == 1
        assert np.ptp(np.bincount(fold, minlength=3)) <= np.bincount(component).max()
    np.testing.assert_array_equal(folds_of(component, 3, 0), folds_of(component, 3, 0))
    assert (folds_of(component, 3, 0) != folds_of(component, 3, 1)).any()
    with pytest.raises(FactoryError, match=r"folds=3: .* fall into 2 components"):
        folds_of(np.array([0, 0, 1]), 3, 0)


def test_fewer_labels_are_among_more() -> None:
    train = list(range(10, 110))
    every, tenth, few = (set(labelled_of(train, share, 0, 1)) for share in (100, 10, 5))
    assert every == set(train)
    assert few < tenth < every
    assert (len(tenth), len(few)) == (10, 5)
    assert labelled_of(train, 0.1, 0, 1), "one at least"
    assert labelled_of(train, 10, 1, 1) != labelled_of(train, 10, 0, 1)


def test_the_plan_tests_every_picture_once_and_none_it_learned_from() -> None:
    component = np.repeat(np.arange(10), 3)
    plan = planned(["noisy", "mine"], [100, 10], [0, 1], component, 2, 40)
    assert len(plan) == 2 * 2 * 2 * 2 + 2 * 2
    for method in ("noisy", "mine"):
        for percent in (100, 10, None):
            for seed in (0, 1):
                own = [
                    one
                    for one in plan
                    if (one.method, one.percent, one.seed) == (method, percent, seed)
                ]
                assert sorted(n for one in own for n in one.tested) == list(range(30))
                for one in own:
                    if percent is None:
                        assert one.learned == tuple(range(40)), "the factory's"
                    else:
                        assert not {*component[[*one.learned]]} & {*component[[*one.tested]]}
    pairs = zip(plan[::2], plan[1::2], strict=True)
    assert all((a.learned, a.tested) == (b.learned, b.tested) for a, b in pairs)


def test_classes_of_few_components_do_not_count() -> None:
    masks = [np.array([[0, one]], np.uint8) for one in (1, 1, 1, 2, 3)]
    component = np.array([0, 0, 0, 1, 2])
    assert counted_classes(masks, component, 1) == {0: (5, 3), 1: (3, 1), 2: (1, 1), 3: (1, 1)}
    assert counted_classes(masks, component, 2) == {0: (5, 3)}


@pytest.mark.skipif(not MDD.is_dir(), reason="needs ../shared/data/mdd")
def test_components_of_the_marine_debris_dataset() -> None:
    """Pictures that correlate above .97 as they are, smoothed, lie in one component."""
    paths = sorted(path for path in (MDD / "Images").iterdir() if path.suffix in PICTURE_SUFFIXES)
    images = [
        cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255 for path in paths
    ]
    found = components(similarity(images) > 0.5)
    sizes = np.bincount(found)
    assert 30 < len(sizes) < 90
    assert sizes[0] < len(images) / 5
    smooth = np.stack([cv2.GaussianBlur(one, (0, 0), 4)[::4, ::4].ravel() for one in images])
    near = np.argwhere(np.triu(np.corrcoef(smooth) > 0.97, 1))
    assert len(near) > 20
    torn = [(a, b) for a, b in near if found[a] != found[b]]
    assert len(torn) <= 0.02 * len(near), torn
