"""10,000 malformed clouds through the reader: refused by name, or read as a slow twin reads them, byte by byte."""

from __future__ import annotations

import math
import random
import signal
import struct
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from cloud_fuzz import MUTATIONS, TIME_NAMES, broken_cloud, right_cloud
from cloud_messages import CODES, Cloud, Field, xyz_cloud

from svc_ros.core.errors import InputError, UnsupportedCloudError
from svc_ros.io.clouds.point_cloud2 import CloudReading, scan_from_cloud

NUM_BATCHES, BATCH = 10, 1000
MARGIN, FILLS = 4096, (0x3D, 0xC7)  # around the data: small floats, and large negative ones
MAX_SECONDS, MAX_SECONDS_A_BATCH = 1.0, 6.0


@pytest.fixture(autouse=True)
def _no_hang() -> Iterator[None]:
    """A reader that never returns fails its test."""

    def give_up(*_: object) -> None:
        raise TimeoutError("a cloud was not read in 60 s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


# The twin: knows nothing of arrays, reads value by value, and says what a refusal may name


UNITS_NS = (1, 1_000, 1_000_000, 10**9)


@dataclass(frozen=True)
class SlowReading:
    """What a cloud holds; `stored` are all its points, of which `points` are usable."""

    points: list[tuple[float, ...]]
    stored: list[tuple[float, ...]]
    times: list[float] | None


def is_scalar(field: Field) -> bool:
    return field.datatype in CODES and field.count in (0, 1)


def size_of(field: Field) -> int:
    return struct.calcsize(CODES.get(field.datatype, "B")) * max(field.count, 1)


def wrongs_of(cloud: Cloud) -> list[str]:
    """What is wrong, as words of which a refusal has to use one; empty for a cloud that can be read."""
    width, height, step = cloud.width, cloud.height, cloud.point_step
    if width <= 0 or height <= 0:
        return [f"{width} x {height}"] if width < 0 or height < 0 or cloud.data else []
    wrongs = [f"bytes {f.offset} to" for f in cloud.fields if f.offset < 0 or f.offset + size_of(f) > step]
    for name in "xyz":
        named = [f for f in cloud.fields if f.name == name]
        if len(named) != 1:
            wrongs.append(f"one field '{name}', found {len(named)}")
        elif not is_scalar(named[0]):
            wrongs.append(f"'{name}' to be one number")
    if height > 1 and cloud.row_step != 0 and cloud.row_step < width * step:
        wrongs.append("row_step of at least")
    elif (height - 1) * row_bytes(cloud) + width * step > len(cloud.data):
        wrongs.append("truncated data")
    return wrongs


def row_bytes(cloud: Cloud) -> int:
    return cloud.row_step if cloud.row_step and cloud.height > 1 else cloud.width * cloud.point_step


def slow_reading(cloud: Cloud) -> SlowReading:
    """Read a cloud that `wrongs_of` has nothing against."""
    if cloud.width * cloud.height == 0:
        return SlowReading([], [], None)
    starts = [row * row_bytes(cloud) + i * cloud.point_step for row in range(cloud.height) for i in range(cloud.width)]
    xyz = [next(f for f in cloud.fields if f.name == name) for name in "xyz"]
    stored = list(zip(*([value(cloud, f, start) for start in starts] for f in xyz), strict=True))
    kept = [k for k, point in enumerate(stored) if all(map(math.isfinite, point)) and any(point)]
    return SlowReading([stored[k] for k in kept], stored, slow_times(cloud, [starts[k] for k in kept]))


def value(cloud: Cloud, field: Field, start: int) -> float:
    order = ">" if cloud.is_bigendian else "<"
    return struct.unpack_from(order + CODES[field.datatype], cloud.data, start + field.offset)[0]


def slow_times(cloud: Cloud, starts: list[int]) -> list[float] | None:
    for name in TIME_NAMES:
        named = [f for f in cloud.fields if f.name == name]
        if len(named) != 1 or not is_scalar(named[0]):
            continue
        values = [value(cloud, named[0], start) for start in starts]
        if (offsets := slow_offsets(values, CODES[named[0].datatype], cloud.stamp_ns)) is not None:
            return offsets
    return None


def slow_offsets(values: list[float], code: str, stamp_ns: int) -> list[float] | None:
    """The first reading that touches the stamp, else the first within 2 s of it."""
    if not values or not all(map(math.isfinite, values)):
        return None if values else []
    span = float(max(values)) - float(min(values))
    likely = [unit for unit in UNITS_NS if 0.01 <= span * unit / 1e9 <= 0.5]
    relative = likely or ([10**9] if code in "fd" else [1])
    absolute = likely or [10**9, 1, 1_000, 1_000_000]
    readings = [(unit, [v * (unit / 1e9) for v in values]) for unit in relative]
    for unit in absolute:
        whole, rest = divmod(stamp_ns, unit)
        readings.append((unit, [(v - whole) * (unit / 1e9) - rest * 1e-9 for v in values]))
    largest = max(map(abs, values))
    step = 1.0 if code not in "fd" else math.ulp(largest) if code == "d" else 2.0 ** (math.frexp(largest)[1] - 24)
    near = [r for unit, r in readings if step * unit <= 2e6 and all(abs(offset) <= 2.0 for offset in r)]
    return next((r for r in near if min(r) <= 0.25 and max(r) >= -0.25), near[0] if near else None)


# The comparison


def read_between(cloud: Cloud, fill: int) -> CloudReading | InputError:
    """Read a cloud whose data lie in the middle of other bytes, all equal to `fill`."""
    size = len(cloud.data)
    buffer = np.full(size + 2 * MARGIN, fill, np.uint8)
    buffer[MARGIN : MARGIN + size] = np.frombuffer(cloud.data, np.uint8)
    before, message = buffer.copy(), cloud.message()
    message.data = buffer[MARGIN : MARGIN + size]
    start = time.process_time()
    try:
        found: CloudReading | InputError = scan_from_cloud(message)
    except InputError as error:
        found = error
    assert time.process_time() - start < MAX_SECONDS
    np.testing.assert_array_equal(buffer, before)
    return found


def bits_of(found: CloudReading | InputError) -> tuple[Any, ...]:
    if isinstance(found, InputError):
        return (str(found),)
    scan, counts = found.scan, (found.num_points, found.num_dropped_nan, found.num_dropped_zero, found.time_field)
    arrays = (scan.points, scan.point_times_s, scan.free_directions)
    return (*counts, *(None if array is None else array.tobytes() for array in arrays))


def check_refusal(error: InputError, wrongs: list[str]) -> None:
    text = str(error)
    assert isinstance(error, UnsupportedCloudError)
    assert any(wrong in text for wrong in wrongs), (text, wrongs)
    assert "expected" in text
    assert "found" in text
    assert text.isprintable(), repr(text)  # one line, in a log too
    assert len(text) < 1000


def check_reading(reading: CloudReading, cloud: Cloud) -> None:
    slow = slow_reading(cloud)
    zeros = sum(not any(point) for point in slow.stored)
    free = sum(point == (math.inf,) * 3 for point in slow.stored)
    np.testing.assert_array_equal(reading.scan.points, np.array(slow.points, float).reshape(-1, 3))
    assert (reading.num_points, reading.height, reading.width) == (len(slow.stored), cloud.height, cloud.width)
    assert (reading.num_dropped_zero, reading.num_out_of_range) == (zeros, free)
    assert reading.num_dropped_nan == len(slow.stored) - len(slow.points) - zeros - free
    times = reading.scan.point_times_s
    assert (times is None) == (slow.times is None)
    if slow.times is not None:
        np.testing.assert_array_equal(times, slow.times)
    directions = reading.scan.free_directions
    assert directions is None or 0 < len(directions) <= free


def check(cloud: Cloud) -> str:
    """Read the cloud and compare; returns 'read', or what was wrong with it."""
    wrongs = wrongs_of(cloud)
    found, again = (read_between(cloud, fill) for fill in FILLS)
    assert bits_of(found) == bits_of(again), "bytes outside the data were read"
    if wrongs:
        assert isinstance(found, InputError), f"read, although wrong: {wrongs}"
        check_refusal(found, wrongs)
        return wrongs[0]
    assert not isinstance(found, InputError), f"refused without a cause: {found}"
    check_reading(found, cloud)
    return "read"


@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")
@pytest.mark.parametrize("batch", [k if k < 3 else pytest.param(k, marks=pytest.mark.slow) for k in range(NUM_BATCHES)])
def test_malformed_clouds_are_refused_by_name_or_read_rightly(batch: int) -> None:
    outcomes: Counter[str] = Counter()
    ways: Counter[str] = Counter()
    start = time.process_time()
    for number in range(BATCH):
        rng = random.Random(batch * BATCH + number)
        cloud, how = broken_cloud(rng, right_cloud(rng))
        try:
            outcomes[check(cloud)] += 1
        except Exception as error:
            raise AssertionError(f"cloud {batch * BATCH + number}, broken by {how}: {cloud!r:.600}") from error
        ways.update(how)
    assert time.process_time() - start < MAX_SECONDS_A_BATCH
    assert 0.2 * BATCH < outcomes["read"] < 0.8 * BATCH  # neither is rare
    assert set(ways) == set(MUTATIONS)
    assert min(ways.values()) > 20


def test_right_clouds_are_read() -> None:
    for seed in range(500):
        assert check(right_cloud(random.Random(seed))) == "read"


# Numbers that no middleware delivers, but a class without checks may hold


@pytest.mark.parametrize("bad", [None, 3.5, math.nan, math.inf, "12", b"1", [1], np.array([1, 2]), object()])
@pytest.mark.parametrize("name", ["width", "height", "point_step", "row_step"])
def test_what_is_no_whole_number_is_refused_by_name(name: str, bad: Any) -> None:
    message = xyz_cloud([[1.0, 2.0, 3.0]]).message()
    setattr(message, name, bad)
    with pytest.raises(UnsupportedCloudError, match=f"expected {name} to be a whole number, found"):
        scan_from_cloud(message)


@pytest.mark.parametrize("name", ["offset", "datatype", "count"])
def test_what_is_no_whole_number_in_a_field_is_refused_by_name(name: str) -> None:
    message = xyz_cloud([[1.0, 2.0, 3.0]]).message()
    setattr(message.fields[1], name, 0.5)
    with pytest.raises(UnsupportedCloudError, match=f"expected {name} to be a whole number, found 0.5"):
        scan_from_cloud(message)


@pytest.mark.parametrize("size", [np.array(1), np.uint32(1), np.int64(1), True])
def test_whole_numbers_of_any_type_are_taken(size: Any) -> None:
    message = xyz_cloud([[1.0, 2.0, 3.0]]).message()
    message.width = message.height = size
    assert len(scan_from_cloud(message).scan) == 1


@pytest.mark.parametrize("data", [np.array(7, np.uint8), np.float64(1.0), np.zeros(0), np.zeros((2, 0), np.uint8)])
def test_data_without_a_length_is_too_short(data: Any) -> None:
    message = xyz_cloud([[1.0, 2.0, 3.0]]).message()
    message.data = data
    with pytest.raises(UnsupportedCloudError, match="truncated data: expected 12 bytes"):
        scan_from_cloud(message)


@pytest.mark.parametrize("origin", [[1.0, 2.0], np.zeros((3, 3)), [0.0, math.nan, 0.0], "here"])
def test_a_sensor_origin_that_is_no_point_is_refused(origin: Any) -> None:
    with pytest.raises(InputError, match="sensor_origin"):
        scan_from_cloud(xyz_cloud([[math.inf] * 3, [1.0, 2.0, 3.0]]).message(), sensor_origin=origin)
