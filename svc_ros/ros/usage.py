"""What `registration_node --help` says, and which of its words cannot be meant as they are written. No rclpy here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from svc_ros.ros.start_notes import INPUT_TOPICS

USAGE = """\
usage: registration_node [-h] [--ros-args [-p NAME:=VALUE ...] [-r FROM:=TO ...] [--params-file FILE]]

Registers LiDAR scans without an initial guess, and gives exactly one decision on each pair: accepted with a
transform, or rejected / undecided with a reason. It runs until Ctrl-C.

modes (-p mode:=MODE), and the topics that they take:
  pair           source_points, target_points: pairs of clouds by stamp; initial_guess, if there is one (the default)
  scan_matching  points: where the sensor is, scan by scan
  loop_closure   points: places that are seen again; odometry is its own, or comes by topic (odom) or TF
  localization   points: where the sensor is in a map (map_folder); initialpose is judged, if there is one

parameters come behind --ros-args, each with -p, topics of your own with -r:
  registration_node --ros-args -p mode:=scan_matching -p preset:=lidar_indoor -r points:=/lidar/points
  registration_node --ros-args --params-file mine.yaml      (svc_ros config lidar_outdoor --out mine.yaml)
presets: lidar_outdoor, lidar_indoor, rgbd_indoor, auto

answers: /svc_registration/decision (every verdict, with its reason); accepted ones on /svc_registration/transform,
/pose, in scan_matching /odometry and /path; counts by the service /svc_registration/status; health on /diagnostics.

all parameters, topics and reasons: docs/reference.md; messages: docs/interfaces.md;
nothing arrives, or all is rejected: docs/decisions.md
"""
_NEED_ROS_ARGS = ("-p", "--param", "-r", "--remap", "--params-file")


def needs_rclpy(what: str, error: ImportError) -> str:
    """One line for who has no rclpy: what needs it, and how to get it."""
    return (
        f"{what} needs rclpy: pip install 'svc_ros[ros]' on a machine without ROS, "
        f"or apt install ros-jazzy-rclpy and source /opt/ros/jazzy/setup.bash ({error})"
    )


def is_help_wanted(words: Sequence[str]) -> bool:
    """True if one of the words that are not ROS's asks for the usage."""
    return any(word in ("-h", "--help") for word in _own_words(words))


def misplaced(words: Sequence[str]) -> str | None:
    """What is wrong with words that ROS would pass over in silence, and how to write them; None if nothing is.

    Words that mean nothing here are let through: other tools add some of their own.
    """
    for word in _own_words(words):
        if ":=" in word:
            return _refusal(word, f"{_flag_of(word)} {word}")
        if word in _NEED_ROS_ARGS:
            return _refusal(word, f"{word} ...")
    return None


def _refusal(word: str, rest: str) -> str:
    return f"{word} stands before --ros-args and would not be read; write: registration_node --ros-args {rest}"


def _flag_of(assignment: str) -> str:
    """What goes before NAME:=VALUE: -r for names of the graph, else -p."""
    name = assignment.partition(":=")[0]
    return "-r" if name in INPUT_TOPICS or name.startswith(("/", "~", "__")) else "-p"


def _own_words(words: Sequence[str]) -> Iterator[str]:
    """The words outside of `--ros-args ... --`."""
    is_own = True
    for word in words:
        if word == "--ros-args":
            is_own = False
        elif word == "--" and not is_own:
            is_own = True
        elif is_own:
            yield word
