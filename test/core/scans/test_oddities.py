"""Scans that cannot be registered, by what is odd about their numbers; and ordinary ones, about which nothing is."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from assertions import assert_same_bits
from simulated_scans import Place, scan_at

from svc_ros.core.auto_preset import choose_preset, look_out
from svc_ros.core.config import preset
from svc_ros.core.errors import TooFewPointsError
from svc_ros.core.registration import prepare, register, verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Scan
from svc_ros.core.scans.oddities import explain_few_points, explain_scan
from svc_ros.pipeline.decide import register_pair

CONFIG = preset("lidar_outdoor")
STREET = scan_at(Place("street", "HDL-32E", 0, 10.0))[0].points
TARGET = scan_at(Place("street", "HDL-32E", 0, 12.0))[0].points
HERE = np.zeros(3)
UTM = np.array([500_000.0, 5_400_000.0, 300.0])


def why_few(points: np.ndarray) -> str:
    with pytest.raises(TooFewPointsError) as raised:
        prepare(Scan(points), CONFIG)
    hint = explain_few_points(points, HERE, CONFIG.preprocess)
    assert str(raised.value).endswith(hint)
    return hint


def answer(source: np.ndarray, target: np.ndarray) -> RegistrationResult:
    scans = Scan(source), Scan(target)
    return register_pair(*scans, choose_preset(scans).config)


class TestOutOfRange:
    def test_millimetres_are_told_with_what_they_would_be(self) -> None:
        reach = np.quantile(np.linalg.norm(STREET, axis=1), 0.98)
        hint = why_few(1000.0 * STREET)
        assert "millimetres?" in hint
        assert hint.endswith(f"within {reach:.3g} m")

    def test_coordinates_of_a_map_are_told_with_the_place(self) -> None:
        hint = why_few(STREET + UTM)
        assert "coordinates of a map or UTM" in hint
        told = np.array(re.findall(r"\((\S+), (\S+), (\S+)\)", hint)[0], float)
        np.testing.assert_allclose(told, np.median(STREET + UTM, axis=0), atol=0.5)
        assert "millimetres" not in hint

    def test_something_near_in_millimetres_may_be_a_map_too_and_both_are_named(self) -> None:
        wall = np.random.default_rng(0).uniform((600.0, -200.0, -150.0), (650.0, 200.0, 150.0), (5000, 3))
        hint = why_few(wall)
        assert "coordinates of a map or UTM" in hint
        assert "or millimetres of a sensor that looks one way, within 0.68 m" in hint

    def test_neither_metres_nor_millimetres(self) -> None:
        assert why_few(1e6 * STREET).endswith("neither metres nor millimetres")

    def test_a_sensor_that_sees_farther_than_the_preset(self) -> None:
        ranges = np.linalg.norm(STREET, axis=1, keepdims=True)
        assert "raise it, if the sensor sees so far" in why_few(STREET / ranges * (100.0 + ranges))

    @pytest.mark.parametrize("factor", [1e-3, 1e-2])
    def test_a_cloud_that_was_scaled_down(self, factor: float) -> None:
        assert "scaled (kilometres, or to a size of one)" in why_few(factor * STREET)

    def test_both_limits_at_once(self) -> None:
        directions = STREET / np.linalg.norm(STREET, axis=1, keepdims=True)
        ranges = np.resize([0.5, 0.5, 20.0, 150.0, 150.0], len(STREET))[:, None]
        few = (directions[:450] * ranges[:450])
        assert "40% of the points lie nearer than preprocess.min_range_m (1 m), 40% beyond" in why_few(few)

    def test_feet_are_a_larger_place_and_nothing_is_said(self) -> None:
        assert explain_scan(prepare(Scan(3.2808 * STREET), CONFIG)) == ""

    def test_the_sensor_may_stand_anywhere(self) -> None:
        assert explain_scan(prepare(Scan(STREET + UTM, sensor_origin=UTM), CONFIG)) == ""

    def test_one_point_beyond_all_numbers_changes_no_hint(self) -> None:
        for far in (1e30, 1e200):
            assert "millimetres?" in why_few(np.vstack([1000.0 * STREET, [far, -far, far]]))

    @pytest.mark.parametrize("judge", [register, lambda s, t, c: verify(s, t, np.eye(4), c)])
    def test_whoever_asks_is_told(self, judge: object) -> None:
        with pytest.raises(TooFewPointsError, match="millimetres"):
            judge(Scan(1000.0 * STREET), Scan(TARGET), CONFIG)  # type: ignore[operator]


class TestFewPoints:
    @pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((5000, 3))])
    def test_nothing_to_use(self, points: np.ndarray) -> None:
        assert why_few(points).startswith("no point can be used")

    def test_ten_points(self) -> None:
        assert why_few(STREET[:10]).startswith("the cloud has too few points itself")

    def test_copies_of_one_point(self) -> None:
        assert "copies of few points" in why_few(np.repeat(STREET[:1], 5000, axis=0))


def wall(shift: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.column_stack([np.full(8000, 8.0), rng.uniform(-15, 15, 8000) + shift, rng.uniform(-3, 6, 8000)])


def laser_line(shift: float = 0.0) -> np.ndarray:
    angle = np.radians(np.arange(0, 360, 0.25))
    ranges = 8 + 3 * np.sin(3 * angle) + 2 * (np.sin(9 * angle) > 0)
    return np.column_stack([ranges * np.cos(angle) + shift, ranges * np.sin(angle), 0.1 * ranges * np.cos(angle)])


class TestShapes:
    @pytest.mark.parametrize(
        ("source", "target", "hint"),
        [
            (wall(), wall(1.0), "both scans: all points lie on one plane"),
            (laser_line(), laser_line(0.1), "both scans: all points lie in one plane with the sensor"),
            (np.outer(np.linspace(1, 60, 5000), [1, 1, 0.2]), TARGET, "source: all points lie on one line"),
        ],
    )
    def test_a_plane_and_a_line_fix_no_pose(self, source: np.ndarray, target: np.ndarray, hint: str) -> None:
        result = answer(source, target)
        assert result.verdict is not Verdict.ACCEPTED
        assert hint in result.detail


class TestPointOfView:
    def test_two_sensors_in_one_cloud_as_if_they_stood_in_one_place(self) -> None:
        both = np.vstack([STREET, scan_at(Place("street", "HDL-32E", 0, 11.5, 30.0))[0].points])
        assert "of several sensors" in explain_scan(prepare(Scan(both), CONFIG))
        assert explain_scan(prepare(Scan(STREET), CONFIG)) == ""

    def test_it_ends_the_detail_of_what_is_not_accepted(self) -> None:
        off = Scan(STREET, sensor_origin=np.array([-4.0, 15.0, 0.0]))
        result = verify(off, Scan(TARGET), np.eye(4), CONFIG)
        assert result.verdict is not Verdict.ACCEPTED
        assert "; source: in " in result.detail
        assert "several surfaces lie behind each other" in result.detail

    def test_what_is_accepted_is_left_alone(self) -> None:
        result = answer(STREET, TARGET)
        assert (result.verdict, ";" in result.detail) == (Verdict.ACCEPTED, False)


class TestHarmless:
    """Odd, and registered all the same."""

    @pytest.mark.parametrize("copies", [2, 50])
    def test_every_point_several_times(self, copies: int) -> None:
        once = prepare(Scan(STREET[::10]), CONFIG)
        repeated = prepare(Scan(np.repeat(STREET[::10], copies, axis=0)), CONFIG)
        np.testing.assert_allclose(repeated.points, once.points, atol=1e-9)
        assert_same_bits(repeated.range_image.near, once.range_image.near)

    @pytest.mark.parametrize("far", [1e30, 1e200])
    def test_one_giant_outlier(self, far: float) -> None:
        plain, odd = Scan(STREET), Scan(np.vstack([STREET, [far, -far, far]]))
        assert_same_bits(prepare(odd, CONFIG).points, prepare(plain, CONFIG).points)
        assert choose_preset([odd]).preset == choose_preset([plain]).preset

    def test_whole_metres(self) -> None:
        result = answer(np.round(STREET), np.round(TARGET))
        assert result.reason in (Reason.OK, Reason.INSUFFICIENT_EVIDENCE, Reason.SIGHT_VIEW_BLOCKED, Reason.LOW_OVERLAP)


def test_a_large_cloud_is_measured_in_parts() -> None:
    """By parts the outlook is the same as by all of its points at once."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(2**18 + 1000, 3)) * [30.0, 10.0, 1.0]
    ranges = np.linalg.norm(points, axis=1)
    far = ranges > 0.3
    found = look_out(points, HERE)
    assert found is not None
    assert found.reach_m == pytest.approx(np.quantile(ranges[far], 0.98))
    assert found.concentration == pytest.approx(np.linalg.norm((points[far] / ranges[far, None]).mean(0)), abs=1e-12)


def test_the_hint_of_a_scan_needs_no_image() -> None:
    assert explain_scan(dataclasses.replace(prepare(Scan(STREET), CONFIG), range_image=None)) == ""
