"""What the log says at the start about the parameters that were given."""

from __future__ import annotations

import pytest

from svc_ros.ros.start_notes import differences, unmatched_overrides

RESOLVED = {"points": "/robot/lidar/points", "odom": "/robot/odom"}
DECLARED = [
    f"qos_overrides.{topic}.subscription.{policy}"
    for topic in ("/robot/lidar/points", "/robot/odom")
    for policy in ("reliability", "depth", "history")
]


def resolved(topic: str) -> str:
    return RESOLVED.get(topic, f"/robot/{topic}")


@pytest.mark.parametrize(
    ("given", "near"),
    [
        ("/points.subscription.reliability", "/robot/lidar/points.subscription.reliability"),
        ("/robot/odmo.subscription.depth", "/robot/odom.subscription.depth"),
        ("/robot/lidar/points.subscription.realiability", "/robot/lidar/points.subscription.reliability"),
    ],
)
def test_an_override_that_fits_no_input_is_told_with_the_nearest_name(given, near):
    (line,) = unmatched_overrides([f"qos_overrides.{given}", *DECLARED], DECLARED, resolved)
    assert line.startswith(f"parameter qos_overrides.{given} fits no input")
    assert line.endswith(f"did you mean qos_overrides.{near}?")


def test_overrides_that_fit_those_of_other_modes_and_those_of_rclpy_are_not_told():
    others = [f"qos_overrides./{topic}.subscription.depth" for topic in ("robot/source_points", "clock")]
    assert unmatched_overrides([*DECLARED, *others, "mode"], DECLARED, resolved) == []


def test_only_what_differs_is_told():
    defaults = {"max_skew": 0.05, "sensor_frame": "", "process_every": False, "sensor_origin": (0.0, 0.0, 0.0)}
    assert differences("lidar_indoor", dict(defaults), defaults) == ""
    changed = {"sensor_frame": "lidar", "process_every": True, "max_skew": 0.05, "sensor_origin": (0.0, 0.0, 1.5)}
    assert differences("lidar_indoor", changed, defaults) == (
        'set beside preset lidar_indoor: sensor_frame "lidar" (not ""), process_every true (not false), '
        "sensor_origin [0.0, 0.0, 1.5] (not [0.0, 0.0, 0.0])"
    )
