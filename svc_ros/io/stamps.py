"""Nanosecond stamps as decimal text. float64 seconds lose the last two digits of today's stamps, text does not."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

from svc_ros.core.errors import InputError

_NS_IN_S = 1_000_000_000


def text_from_ns(stamp_ns: int) -> str:
    """Write a stamp [ns] as seconds with nine decimals, exactly."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, rest = divmod(abs(int(stamp_ns)), _NS_IN_S)
    return f"{sign}{seconds}.{rest:09d}"


def ns_from_text(text: str) -> int:
    """Read seconds written as decimal text into nanoseconds, exactly; digits below 1 ns are rounded."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise InputError(f"stamp: expected seconds as a number, found {text!r:.40}") from None
    if not value.is_finite() or abs(value) >= 2**63 // _NS_IN_S:
        raise InputError(f"stamp: expected seconds that fit 64 bits of nanoseconds, found {text!r:.40}")
    return int((value * _NS_IN_S).to_integral_value())


def ns_from_stamp(stamp: object) -> int:
    """Nanoseconds of a ROS time message (ROS 2: `sec`, `nanosec`; ROS 1: `secs`, `nsecs`)."""
    seconds = getattr(stamp, "sec", getattr(stamp, "secs", None))
    rest = getattr(stamp, "nanosec", getattr(stamp, "nsecs", None))
    if seconds is None or rest is None:
        raise InputError(f"stamp: expected a time with sec and nanosec, found {type(stamp).__name__}")
    return int(seconds) * _NS_IN_S + int(rest)


def seconds_and_rest(stamp_ns: int) -> tuple[int, int]:
    """Split nanoseconds into the `sec` and `nanosec` of a ROS time message."""
    return divmod(int(stamp_ns), _NS_IN_S)
