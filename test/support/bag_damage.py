"""Bags of several chunks, and what happens to bags on their way: for the tests of what reads them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_recorder import CLOUD, START, Recorder, S, messages_of, points_of, record
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from svc_ros.io.bags import Bag

NUM_CLOUDS = 6


def clouds(num: int, first: int = 0) -> Callable[[Recorder], None]:
    """Fills a bag with so many clouds on /points, a second apart."""

    def fill(recorder: Recorder) -> None:
        for k in range(first, first + num):
            recorder.cloud("/points", START + k * S, points_of(k))

    return fill


def chunked_mcap(path: Path, compression: str = "zstd", enable_crcs: bool = True) -> Path:
    """NUM_CLOUDS clouds, each in a chunk of its own, by another writer than rosbags'."""
    writing = pytest.importorskip("mcap.writer", reason="mcap is not installed")
    source = record(path.with_name("source"), "mcap", clouds(NUM_CLOUDS))
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as file:
        kind = getattr(writing.CompressionType, compression.upper())
        writer = writing.Writer(file, chunk_size=64, compression=kind, enable_crcs=enable_crcs)
        writer.start(profile="ros2")
        definition = store.generate_msgdef(CLOUD, ros_version=2)[0].encode()
        schema = writer.register_schema(CLOUD, "ros2msg", definition)
        channel = writer.register_channel("/points", "cdr", schema)
        for stamp, message in messages_of(source)["/points"]:
            writer.add_message(channel, stamp, bytes(store.serialize_cdr(message, CLOUD)), stamp)
        writer.finish()
    return path


def chunked_ros1(path: Path, compression: str = "none") -> Path:
    """The same as a ROS 1 bag."""
    writer = Ros1Writer(path)
    writer.chunk_threshold = 64
    if compression != "none":
        writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
    with writer:
        clouds(NUM_CLOUDS)(Recorder(writer, ros1=True))
    return path


def chunk_places(path: Path) -> list[tuple[int, int]]:
    """Where each chunk's record begins and how long its data are, told apart from what they hold by the index."""
    data, found = path.read_bytes(), []
    if path.suffix == ".mcap":
        at = 8
        while at < len(data) - 8:
            op, length = struct.unpack_from("<BQ", data, at)
            found += [(at, length)] if op == 6 else []
            at += 9 + length
        return found
    at = 13
    while at < len(data):
        header = struct.unpack_from("<I", data, at)[0]
        length = struct.unpack_from("<I", data, at + 4 + header)[0]
        found += [(at, length)] if b"op=\x05" in data[at : at + 4 + header] else []
        at += 8 + header + length
    return found


def overwrite(path: Path, start: int, length: int = 1, value: int = 0xA5) -> Path:
    data = bytearray(path.read_bytes())
    data[start : start + length] = bytes([value]) * length
    path.write_bytes(bytes(data))
    return path


def cut(path: Path, keep: int) -> Path:
    path.write_bytes(path.read_bytes()[:keep])
    return path


def ends_of_clouds(path: Path, num: int) -> list[int]:
    """Where the message of each cloud ends in an uncompressed file: one byte, is_dense, follows the points."""
    data = path.read_bytes()
    return [data.index(points_of(k).tobytes()) + points_of(k).nbytes + 1 for k in range(num)]


def seconds_read(path: Path) -> tuple[list[int], list[str]]:
    """Which clouds (by their second) a bag gives, each checked point by point, and the damage that it tells."""
    with Bag(path) as bag:
        readings = list(bag.scans("/points"))
        told = [str(damage) for damage in bag.damage]
    seconds = [(reading.scan.stamp_ns - START) // S for reading in readings]
    for k, reading in zip(seconds, readings, strict=True):
        np.testing.assert_array_equal(reading.scan.points, points_of(k))
    return seconds, told


