"""The labelled poses by what real sensors do: groups, labels, overlaps."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from svc_ros.core import se3
from svc_ros.core.config import PRESETS

pytestmark = pytest.mark.usefixtures("scripts")
GROUPS = (
    "simulated smear", "simulated mixed pixels and glass", "simulated narrow view", "simulated depth camera",
    "simulated tripod",
)  # fmt: skip


def first_place(group: str):
    from lib import simulated_sensors

    return next(place for place in simulated_sensors.places() if place.dataset == group)


def test_every_group_has_its_places_and_a_preset():
    from lib import simulated_sensors

    places = simulated_sensors.places()
    assert tuple(simulated_sensors.PRESETS) == GROUPS
    assert set(simulated_sensors.PRESETS.values()) <= set(PRESETS)
    assert len(set(places)) == len(places)
    assert pickle.loads(pickle.dumps(places)) == places
    for group in GROUPS:
        assert 12 <= sum(place.dataset == group for place in places) <= 24
    assert not {place.seed for place in places} & {place.seed + 1000 for place in places}


@pytest.mark.parametrize("group", [*GROUPS[:2], *(pytest.param(group, marks=pytest.mark.slow) for group in GROUPS[2:])])
def test_pairs_overlap_and_are_labelled_by_the_true_pose(group: str):
    from lib import simulated_sensors
    from lib.simulated_pairs import GROUPS as MADE

    place = first_place(group)
    pair, (same, *other) = simulated_sensors.overlapping_pair(place), simulated_sensors.judge(place)
    assert pair.overlap > 0.3
    assert same.dataset == group
    truth, *wrong = same.candidates
    assert (truth.label, truth.origin) == ("correct", "truth")
    assert np.array_equal(truth.T_target_source, same.reference)
    assert np.allclose(same.reference, pair.T_target_source)
    errors = [se3.pose_error(candidate.T_target_source, same.reference) for candidate in wrong]
    assert [candidate.label for candidate in wrong] == ["wrong"] * 8
    assert [candidate.origin for candidate in wrong] == ["slip"] * 4 + ["turn"] * 4
    least, most = MADE[group].slip_m
    assert all(angle < 1e-3 and least <= distance <= most for angle, distance in errors[:4])
    assert [angle for angle, _ in errors[4:]] == pytest.approx(MADE[group].wrong_turns_deg, abs=1e-3)
    for candidate in wrong:  # along the ground, about the vertical
        moved = (candidate.T_target_source - same.reference)[:3, 3] @ pair.T_world_target[:3, :3].T
        assert abs(moved[2]) < 0.1 * np.linalg.norm(moved) + 1e-9
    for judged in other:
        assert [(c.label, c.origin) for c in judged.candidates] == [("wrong", "register")]


def test_places_follow_from_their_seed_and_differ_by_sensor():
    from lib import simulated_pairs as pairs

    place = first_place(pairs.NARROW)
    first, again = (pairs.overlapping_pair(place) for _ in range(2))
    assert np.array_equal(first.source.points, again.source.points)
    other = next(p for p in pairs.places() if p.dataset == pairs.NARROW and p.sensor != place.sensor)
    assert not np.allclose(pairs.overlapping_pair(other).T_target_source, first.T_target_source)


def test_cars_keep_within_what_bends_allow_and_nothing_stands_on_the_track():
    from lib import simulated_pairs as pairs

    smeared = [place for place in pairs.places() if place.dataset == pairs.SMEAR]
    for place in smeared:
        motion = pairs._motion(place, (20.0, 0.0, 0.0, 10.0, 0.0), 0)
        speed, turn = np.linalg.norm(motion.velocity_mps), abs(motion.turn_rate_dps[2])
        assert 5.0 - 1e-9 <= speed <= 15.0 + 1e-9
        assert speed * np.radians(turn) <= 3.0 + 1e-9
        assert (turn > 0.0) == (place.seed % 2 == 1)
        assert np.degrees(np.arctan2(*motion.velocity_mps[1::-1])) == pytest.approx(-10.0)  # yawed to the left
    scene, _ = pairs._world("street", 41, 0.0)
    ways = [o.motion.pose(0.0) for o in scene.objects if o.motion is not None]
    near = [np.linalg.norm(scene.track.points - T[:3, 3], axis=1).min() for T in ways if T is not None]
    assert near
    assert min(near) > 2.5


def test_rows_are_measured_as_of_other_sets():
    from lib import simulated_sensors

    rows = simulated_sensors.gather_simulated((first_place("simulated smear"), 0))
    assert {row.dataset for row in rows} == {"simulated smear"}
    assert [row.correct for row in rows[:9]] == [True] + [False] * 8
    assert rows[0].contact is not None
    assert rows[0].moved[1] < 0.6
    assert rows[0].seen["refined"]["oriented_overlap_ratio"] > 0.3
