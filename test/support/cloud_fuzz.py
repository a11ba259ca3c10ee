"""Malformed clouds without end, the same ones in each run: right clouds, broken in one to three ways."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from cloud_messages import CODES, Cloud, Column, Field, Layout, pack

TIME_NAMES = ("t", "time", "timestamp", "offset_time", "time_stamp")
SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-45, 3.4e38, -3.4e38, 1.7e308, -1.7e308)
NAMES = ("x", "y", "z", "X", "", " x", "x\n", "t", "time", "ring", "é", "n" * 3000)
FRAMES = ("", "lidar\nbroken", "f" * 5000, "/lidar")
STAMPS = (0, -1, 2**31 * 10**9, 2**63, -(2**40) * 10**9, 10**30)


def right_cloud(rng: random.Random) -> Cloud:
    """A cloud that can be read: any layout, number types and byte order, with some values that are no points."""
    if rng.random() < 0.06:
        return beams(rng)
    height, width = rng.choice((1, 1, 2, 3, 4)), rng.randint(1, 9)
    names = ["x", "y", "z", *rng.sample((*TIME_NAMES, "ring", "intensity"), rng.choice((0, 0, 1, 2)))]
    rng.shuffle(names)
    one_type = rng.choice((None, 7, 7, 8))
    columns, end = [], 0
    for name in names:
        datatype = one_type or rng.randint(1, 8)
        offset = end + rng.choice((0, 0, 0, 1, 3, 8))
        end = offset + struct.calcsize(CODES[datatype])
        values = values_of(rng, name, datatype, height * width)
        columns.append(Column(name, values, datatype, offset, rng.choice((0, 1, 1))))
    step = end + rng.choice((0, 0, 1, 4))
    row_step = width * step + rng.choice((0, 0, 0, 5, 64))
    return pack(columns, Layout(height, step, row_step, rng.random() < 0.3, rng.choice((0, 0xA5, 0xFF))))


def values_of(rng: random.Random, name: str, datatype: int, count: int) -> list[float]:
    """Coordinates or times of one number type, one in ten of them special."""
    code = CODES[datatype]
    if code not in "fd":
        bits = 8 * struct.calcsize(code)
        low = 0 if code.isupper() else -(2 ** (bits - 1))
        return [rng.choice((0, low, low + 2**bits - 1, rng.randint(low, low + 2**bits - 1))) for _ in range(count)]
    special = SPECIAL if code == "d" else SPECIAL[:8]  # the last ones do not fit
    scale, start = (0.05, rng.choice((0.0, 1_500_000_000.25, 1.50000000025e18))) if name in TIME_NAMES else (20.0, 0.0)
    return [start + rng.gauss(0.0, scale) if rng.random() < 0.9 else rng.choice(special) for _ in range(count)]


def beams(rng: random.Random) -> Cloud:
    """An organised sweep of three rows, in which some beams met nothing: at +inf."""
    width, points = rng.choice((36, 40, 60)), []
    for elevation in (-0.2, 0.0, 0.2):
        for k in range(width):
            a, r = 2.0 * math.pi * k / width, rng.uniform(2.0, 30.0)
            seen = (r * math.cos(a), r * math.sin(a), r * math.tan(elevation))
            strange = tuple(rng.choice((*SPECIAL, 3.0)) for _ in range(3))
            points.append(rng.choices((seen, (math.inf,) * 3, strange), (0.75, 0.2, 0.05))[0])
    columns = [Column(name, values, 8) for name, values in zip("xyz", zip(*points, strict=True), strict=True)]
    return pack(columns, Layout(height=3, bigendian=rng.random() < 0.3))


# Ways to break a cloud


def _size(name: str) -> Callable[[random.Random, Cloud], Cloud]:
    def change(rng: random.Random, cloud: Cloud) -> Cloud:
        old = getattr(cloud, name)
        near = (0, 1, old - 1, old + 1, 2 * old, old // 2, rng.randint(0, 40))
        far = (-1, -old, 2**31 - 1, 2**31, 2**32 - 1, 2**32 - old, 2**63, 2**64 // max(old, 1))
        return replace(cloud, **{name: rng.choice(near + far)})

    return change


def _field(make: Callable[[random.Random, Cloud, Field], dict[str, Any]]) -> Callable[[random.Random, Cloud], Cloud]:
    def change(rng: random.Random, cloud: Cloud) -> Cloud:
        if not cloud.fields:
            return cloud
        fields, i = list(cloud.fields), rng.randrange(len(cloud.fields))
        fields[i] = replace(fields[i], **make(rng, cloud, fields[i]))
        return replace(cloud, fields=tuple(fields))

    return change


def _offset(rng: random.Random, cloud: Cloud, field: Field) -> dict[str, Any]:
    step = cloud.point_step
    far = (-1, -field.offset, step, step - 1, 2**31 - 1, 2**32 - 1, 2**32 - field.offset, 2**64)
    return {"offset": rng.choice((rng.randint(0, max(step, 0) + 4), rng.choice(far)))}


def _shuffled(rng: random.Random, fields: Sequence[Field]) -> tuple[Field, ...]:
    return tuple(rng.sample(list(fields), len(fields)))


def _without_one(rng: random.Random, cloud: Cloud) -> Cloud:
    keep = rng.randrange(max(len(cloud.fields), 1))
    return replace(cloud, fields=cloud.fields[:keep] + cloud.fields[keep + 1 :])


def _noise(rng: random.Random, cloud: Cloud) -> Cloud:
    data = bytearray(cloud.data)
    for _ in range(rng.randint(1, 16) if data else 0):
        data[rng.randrange(len(data))] = rng.choice((0, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return replace(cloud, data=bytes(data))


def _special_values(rng: random.Random, cloud: Cloud) -> Cloud:
    data, code = bytearray(cloud.data), rng.choice(("<f", ">f", "<d", ">d"))
    size = struct.calcsize(code)
    for _ in range(rng.randint(1, 8) if len(data) >= size else 0):
        value = rng.choice(SPECIAL if code[1] == "d" else SPECIAL[:8])
        struct.pack_into(code, data, rng.randrange(len(data) - size + 1), value)
    return replace(cloud, data=bytes(data))


MUTATIONS: dict[str, Callable[[random.Random, Cloud], Cloud]] = {
    **{name: _size(name) for name in ("width", "height", "point_step", "row_step")},
    "swapped": lambda _, c: replace(c, width=c.height, height=c.width),
    "offset": _field(_offset),
    "datatype": _field(lambda rng, _c, _f: {"datatype": rng.choice((0, 1, 2, 7, 8, 8, 9, 255, -1))}),
    "count": _field(lambda rng, _c, _f: {"count": rng.choice((0, 2, 3, 255, 2**31, 2**32 - 1, -1))}),
    "name": _field(lambda rng, _c, _f: {"name": rng.choice(NAMES)}),
    "duplicate": lambda rng, c: replace(c, fields=c.fields + tuple(rng.sample(c.fields, min(1, len(c.fields))))),
    "missing": _without_one,
    "no fields": lambda _, c: replace(c, fields=()),
    "many fields": lambda rng, c: replace(c, fields=c.fields + (Field(rng.choice(NAMES), 0, 2),) * 300),
    "order": lambda rng, c: replace(c, fields=_shuffled(rng, c.fields)),
    "truncated": lambda rng, c: replace(c, data=c.data[: rng.randint(0, len(c.data))]),
    "one byte less": lambda _, c: replace(c, data=c.data[:-1]),
    "too long": lambda rng, c: replace(c, data=c.data + rng.randbytes(rng.choice((1, 7, 4096)))),
    "no data": lambda _, c: replace(c, data=b""),
    "shifted": lambda rng, c: replace(c, data=c.data[rng.randint(1, 5) :]),
    "noise": _noise,
    "special values": _special_values,
    "byte order": lambda _, c: replace(c, is_bigendian=not c.is_bigendian),
    "density": lambda _, c: replace(c, is_dense=not c.is_dense),
    "frame": lambda rng, c: replace(c, frame_id=rng.choice(FRAMES)),
    "stamp": lambda rng, c: replace(c, stamp_ns=rng.choice(STAMPS)),
}


def broken_cloud(rng: random.Random, cloud: Cloud) -> tuple[Cloud, list[str]]:
    """The cloud, broken in one to three ways, and their names."""
    how = rng.sample(list(MUTATIONS), rng.choice((1, 1, 1, 2, 3)))
    for name in how:
        cloud = MUTATIONS[name](rng, cloud)
    return cloud, how
