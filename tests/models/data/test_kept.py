"""Pictures that serve several visits of a training."""

from __future__ import annotations

import pickle
from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as some

from simnfnd.models.data.crops import KEPT, KeptSource, VisitSampler, drawn
from simnfnd.models.data.pairs import Sample
from simnfnd.models.settings import RendersData
from tests.models.data.data_settings import data_settings


class Counting:
    """Samples that say which visit they are, and how often one was made."""

    def __init__(self) -> None:
        self.made: Counter[tuple[int, int | None]] = Counter()

    def __len__(self) -> int:
        return 5

    def sample(self, index: int, visit: int | None) -> Sample:
        self.made[index, visit] += 1
        picture = np.full((2, 2), index + 10 * (visit or 0), np.float32)
        return Sample(picture, picture, None, None, None)


@given(some.integers(0, 10**6), some.integers(1, 20), some.integers(0, 3))
def test_a_visit_shows_the_newest_picture_or_one_that_is_kept(
    number: int, reuse: int, seed: int
) -> None:
    newest = number // reuse
    found = drawn(number, reuse, seed)
    assert max(newest - KEPT, 0) <= found <= newest
    assert found == drawn(number, reuse, seed)
    if number % reuse == 0:
        assert found == newest
    if reuse == 1:
        assert found == number


def test_kept_pictures_are_those_of_the_source_and_made_once() -> None:
    plain, counting = Counting(), Counting()
    kept = KeptSource(counting)
    for number in range(400):
        picture = drawn(number, 8, 0)
        index, visit = picture % 5, picture // 5
        np.testing.assert_array_equal(
            kept.sample(index, visit).noisy, plain.sample(index, visit).noisy
        )
    assert set(counting.made.values()) == {1}
    assert len(counting.made) == 50
    # Validation pictures are not kept, and a copy in another process begins with none.
    kept.sample(0, None)
    kept.sample(0, None)
    assert counting.made[0, None] == 2
    assert not pickle.loads(pickle.dumps(kept))._kept


def test_the_sampler_goes_on_where_it_was_interrupted() -> None:
    data = data_settings(kind="renders", batch=4, crops=2, reuse=3)
    assert isinstance(data, RendersData)
    whole = VisitSampler(7, data, steps=5, seed=1)
    steps = []
    for interval in range(6):
        whole.begin(interval, 0)
        steps += list(whole)
    later = VisitSampler(7, data, steps=5, seed=1)
    later.begin(4, 0)
    assert list(later) == steps[20:25]
    later.begin(4, 2)
    assert list(later) == steps[22:25]
    visits = [visit for step in steps for visit in step]
    assert [visit.number for visit in visits] == list(range(60))
    shown = {(visit.image, visit.round) for visit in visits}
    assert len(shown) == 20
    # Every picture is another image until all were shown.
    first = [visit for visit in visits if visit.number % 3 == 0][:7]
    assert sorted(visit.image for visit in first) == list(range(7))
