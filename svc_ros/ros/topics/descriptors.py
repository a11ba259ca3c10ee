"""How a parameter of the node is described to ROS, and what is said of one that is not as described."""

from __future__ import annotations

import sys

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from svc_ros.core.config import FieldInfo

_LARGEST_INT = 2**63 - 1


def parameter_descriptor(info: FieldInfo, read_only: bool) -> ParameterDescriptor:
    """A parameter of the node as ROS describes it: text, unit, choices and range."""
    text = f"{info.description} [{info.unit}]" if info.unit else info.description
    constraints = f"one of: {', '.join(info.choices)}" if info.choices else ""
    descriptor = ParameterDescriptor(
        name=info.name, description=text, additional_constraints=constraints, read_only=read_only
    )
    if isinstance(info.default, bool) or (info.low is None and info.high is None):
        return descriptor
    if isinstance(info.default, int):
        low, high = _bounds(info, -_LARGEST_INT, _LARGEST_INT)
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
    else:
        low, high = _bounds(info, -sys.float_info.max, sys.float_info.max)
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
    return descriptor


def type_text(info: FieldInfo, error: Exception) -> str:
    """What was expected of a parameter; a whole number where a double belongs is by far the most frequent slip."""
    kind = "list of doubles" if isinstance(info.default, tuple) else type(info.default).__name__
    if isinstance(info.default, (float, tuple)):
        return f"parameter {info.name}: expected a {kind}; a whole number needs its point (write 1.0, not 1): {error}"
    return f"parameter {info.name}: expected a {kind}: {error}"


def _bounds(info: FieldInfo, lowest: float, highest: float) -> tuple[float, float]:
    return (lowest if info.low is None else info.low), (highest if info.high is None else info.high)
