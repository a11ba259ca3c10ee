"""What the log says at the start about the parameters that were given. No rclpy here."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

INPUT_TOPICS = ("source_points", "target_points", "points", "odom", "initial_guess", "initialpose")  # of all modes
_POLICIES = ("history", "depth", "reliability")  # what may be overridden
_OVERRIDES = "qos_overrides."
_OF_RCLPY = tuple(f"{_OVERRIDES}{topic}." for topic in ("/clock", "/parameter_events", "/rosout"))


def unmatched_overrides(given: Iterable[str], declared: Iterable[str], resolve: Callable[[str], str]) -> list[str]:
    """One line for each `qos_overrides.TOPIC...` that was given and fits no input, with the nearest one declared.

    resolve: the full name of an input. Overrides of an input that only another mode has are let through: a file of
    parameters, or a launch file, may serve several modes.
    """
    known = [name for name in declared if name.startswith(_OVERRIDES)]
    inputs = tuple(f"{_OVERRIDES}{resolve(topic)}.subscription." for topic in INPUT_TOPICS)
    fits = {f"{topic}{policy}" for topic in inputs for policy in _POLICIES}
    wrong = [n for n in given if n.startswith(_OVERRIDES) and n not in fits and not n.startswith(_OF_RCLPY)]
    return [_unmatched(name, known) for name in wrong]


def differences(preset: str, values: Mapping[str, Any], defaults: Mapping[str, Any]) -> str:
    """One line on the values that are not what the preset has; empty if there are none."""
    other = [f"{name} {_text(v)} (not {_text(defaults[name])})" for name, v in values.items() if v != defaults[name]]
    return f"set beside preset {preset}: {', '.join(other)}" if other else ""


def _unmatched(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
    text = f"parameter {name} fits no input and does nothing"
    return text + (f"; did you mean {near[0]}?" if near else "")


def _text(value: object) -> str:
    """The value as a parameter is written."""
    return json.dumps(value)


def unknown_parameter(name: str, known: list[str]) -> str:
    """One line for a name that is none, with the nearest one of those that are."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"parameter {name} does not exist" + (f"; did you mean {near[0]}?" if near else "")
