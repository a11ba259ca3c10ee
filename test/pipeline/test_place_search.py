"""Place search: the answers of comparing one by one, whatever is asked for; quick over ten thousand places."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from place_looks import mixed_look, stacked_looks
from yardstick import Stopwatch

from svc_ros.core.parallel import limit_threads
from svc_ros.pipeline.place import PlaceLook, compare_places
from svc_ros.pipeline.place_search import PlaceIndex, most_alike

SINGLE = 1e-5  # likeness in single precision


def looks(num: int, seed: int = 0) -> list[PlaceLook]:
    rng = np.random.default_rng(seed)
    return [mixed_look(rng) for _ in range(num)]


def one_by_one(wanted: PlaceLook, known: list[PlaceLook]) -> list[tuple[int, float]]:
    likeness = [compare_places(wanted, look)[0] for look in known]
    return [(int(k), likeness[k]) for k in np.argsort([-each for each in likeness], kind="stable")]


@pytest.mark.parametrize("most", [1, 3, 10, 400])
@pytest.mark.parametrize("least", [0.0, 0.9])
def test_answers_are_those_of_comparing_one_by_one(most: int, least: float) -> None:
    known = looks(300)
    index = PlaceIndex(stacked_looks(known))
    for wanted in looks(8, seed=1):
        expected = [pair for pair in one_by_one(wanted, known)[:most] if pair[1] >= least]
        found = index.most_alike(wanted, most, least)
        assert [k for k, _ in found] == [k for k, _ in expected]
        np.testing.assert_allclose([each for _, each in found], [each for _, each in expected], atol=SINGLE)


def test_a_place_is_found_again_however_it_is_turned() -> None:
    known = looks(50)
    index = PlaceIndex(stacked_looks(known))
    steps = np.arange(known[0].spectrum.shape[1])
    for number in (0, 17, 49):
        turned = PlaceLook(known[number].spectrum * np.exp(-2j * np.pi * 31 * steps / 120), np.zeros(3))
        (found, likeness), *_ = index.most_alike(turned, 3)
        assert found == number
        assert likeness == pytest.approx(1.0, abs=SINGLE)


def test_alike_places_come_in_the_order_of_their_numbers() -> None:
    one, other = looks(2)
    index = PlaceIndex(stacked_looks([other, one, one, other, one]))
    assert [k for k, _ in index.most_alike(one, 3)] == [1, 2, 4]


def test_places_that_are_added_are_found_as_those_from_the_beginning() -> None:
    known = looks(150)
    grown = PlaceIndex()
    assert [grown.add(look) for look in known] == list(range(150))
    whole = PlaceIndex(stacked_looks(known))
    assert len(grown) == len(whole) == 150
    for wanted in looks(3, seed=1):
        assert grown.most_alike(wanted, 5) == whole.most_alike(wanted, 5)


def test_a_search_of_a_few_looks_is_that_of_an_index() -> None:
    known, (wanted,) = looks(40), looks(1, seed=1)
    assert most_alike(wanted, known, 3, 0.5) == PlaceIndex(stacked_looks(known)).most_alike(wanted, 3, 0.5)
    assert most_alike(wanted, [], 3) == most_alike(wanted, known, 0) == []


def test_nothing_is_found_where_nothing_is_or_is_wanted() -> None:
    (wanted,) = looks(1)
    assert PlaceIndex().most_alike(wanted, 3) == []
    assert PlaceIndex(stacked_looks(looks(4))).most_alike(wanted, 0) == []
    assert PlaceIndex(stacked_looks(looks(4))).most_alike(wanted, 3, least=1.1) == []


def test_answers_do_not_depend_on_threads() -> None:
    index, wanted = PlaceIndex(stacked_looks(looks(2500))), looks(6, seed=1)
    before = [index.most_alike(look, 5) for look in wanted]
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(lambda look: index.most_alike(look, 5), wanted)) == before
    try:
        limit_threads(1)
        assert [index.most_alike(look, 5) for look in wanted] == before
    finally:
        limit_threads(2**31)


def test_ten_thousand_places_are_searched_in_twenty_milliseconds() -> None:
    index, wanted = PlaceIndex(np.tile(stacked_looks(looks(1000)), (10, 1, 1))), looks(20, seed=1)
    index.most_alike(wanted[0], 10)  # compiled
    with Stopwatch() as watch:
        for look in wanted:
            index.most_alike(look, 10)
    assert watch.own_s < 20 * 0.02, str(watch)
