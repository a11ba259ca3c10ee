"""Which files are a bag, whatever metadata.yaml says; compression of files and messages; types of other topics."""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_damage import clouds, seconds_read
from bag_recorder import CLOUD, START, Recorder, S, points_of, record, three_clouds
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import get_types_from_msg

from svc_ros.core.errors import InputError
from svc_ros.io.bags import Bag
from svc_ros.io.bags.channels import Channel
from svc_ros.io.bags.decoding import UnreadableMessageError, decode
from svc_ros.io.bags.files import is_bag_folder


def edited(path: Path, edit: Callable[[str], str]) -> Path:
    metadata = path / "metadata.yaml"
    metadata.write_text(edit(metadata.read_text()))
    return path


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: re.sub(r"storage_identifier: .*", "storage_identifier: ''", text),
        lambda text: re.sub(r"storage_identifier: .*", "storage_identifier: rosbag_v2", text),
        lambda text: re.sub(r"version: .*", "version: 99", text),
        lambda text: text.replace("serialization_format: cdr", "serialization_format: other"),
        lambda text: re.sub(r"duration:\n    nanoseconds: .*", "duration: {}", text),
    ],
)
def test_files_tell_what_they_are(tmp_path: Path, edit: Callable[[str], str]) -> None:
    assert seconds_read(edited(record(tmp_path / "drive", "db3", three_clouds), edit)) == ([0, 1, 2], [])


@pytest.mark.parametrize("storage", ["mcap", "db3", "mcap_file_zstd", "mcap_message_zstd"])
def test_no_metadata_is_needed(tmp_path: Path, storage: str) -> None:
    path = record(tmp_path / "drive", storage, three_clouds)
    (path / "metadata.yaml").unlink()
    assert is_bag_folder(path)
    assert seconds_read(path) == ([0, 1, 2], [])


def test_several_files_without_metadata_are_read_by_time(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    for name, first in (("drive_10", 0), ("drive_9", 2), ("a", 4)):
        part = record(tmp_path / f"part_{name}", "mcap", clouds(2, first))
        next(part.glob("*.mcap")).rename(folder / f"{name}.mcap")
    assert seconds_read(folder) == ([0, 1, 2, 3, 4, 5], [])
    with Bag(folder) as bag:
        part_of_it = [(stamp - START) // S for stamp, _ in bag.raw_clouds(span_ns=(START + S, START + 2 * S))]
    assert part_of_it == [1, 2]


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("", "it is empty"),
        ("rosbag2_bagfile_information: [", "expected YAML with rosbag2_bagfile_information and its files, found none"),
        ("- 1\n- 2\n", "expected YAML with rosbag2_bagfile_information and its files, found none"),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "it names no file"),
    ],
)
def test_a_broken_metadata_is_told_and_does_without(tmp_path: Path, text: str, cause: str) -> None:
    path = edited(record(tmp_path / "drive", "mcap", three_clouds), lambda _: text)
    read, told = seconds_read(path)
    assert read == [0, 1, 2]
    assert told[0].startswith(f"{path / 'metadata.yaml'}: 3 messages of /points, ")
    assert cause in told[0]
    with pytest.raises(InputError, match=re.escape(cause)):
        Bag(path, strict=True).__enter__()
    next(path.glob("*.mcap")).unlink()
    with pytest.raises(InputError, match=re.escape(cause)):
        Bag(path).__enter__()


def test_files_that_are_named_but_not_there_are_named(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", three_clouds)
    edited(path, lambda text: text.replace("  - drive.mcap\n", "  - drive.mcap\n  - drive_1.mcap\n"))
    read, told = seconds_read(path)
    assert read == [0, 1, 2]
    assert "it names files that are not there: drive_1.mcap" in told[0]
    (path / "drive.mcap").rename(path / "renamed.mcap")
    read, told = seconds_read(path)
    assert read == [0, 1, 2]
    assert "not there: drive.mcap, drive_1.mcap" in told[0]


def test_a_file_with_the_suffix_of_another_format(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", three_clouds)
    assert seconds_read((path / "drive.mcap").rename(tmp_path / "drive.db3")) == ([0, 1, 2], [])


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_compressed_db3(tmp_path: Path, mode: str) -> None:
    writer = Ros2Writer(tmp_path / "drive", version=8, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        three_clouds(Recorder(writer, ros1=False))
    file = next(file for file in (tmp_path / "drive").iterdir() if file.name.startswith("drive.db3"))
    assert file.suffix == {"FILE": ".zstd", "MESSAGE": ".db3"}[mode]
    assert seconds_read(tmp_path / "drive") == ([0, 1, 2], [])
    assert seconds_read(file) == ([0, 1, 2], [])
    with Bag(tmp_path / "drive") as bag:
        assert bag.transforms().frames == ["base", "lidar", "map"]


def test_a_cut_compressed_file_gives_what_is_there(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap_file_zstd", clouds(400))
    file = next(path.glob("*.zstd"))
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    read, told = seconds_read(path)
    assert read == list(range(len(read)))
    assert 0 < len(read) < 400
    assert f"{len(read)} of 400 messages of /points read; its compression is cut or damaged" in told[0]
    file.write_bytes(data[:40])
    with pytest.raises(InputError, match=r"drive\.mcap\.zstd: .* compression is cut or damaged, and nothing"):
        seconds_read(path)


# Types of other topics


def test_types_that_nobody_knows_do_not_hinder(tmp_path: Path) -> None:
    def fill(recorder: Recorder) -> None:
        recorder.store.register(get_types_from_msg("float64 x\nuint8[] data\n", "their_msgs/msg/Radar"))
        recorder.write("/radar", "their_msgs/msg/Radar", START, recorder.make(
            "their_msgs/msg/Radar", x=1.0, data=np.zeros(9, np.uint8)))  # fmt: skip
        recorder.cloud("/points", START, points_of(0))

    path = record(tmp_path / "drive", "db3", fill)
    damages = {
        "no definition": "DELETE FROM message_definitions WHERE topic_type LIKE 'their%'",
        "no definition that can be read":
            "UPDATE message_definitions SET encoded_message_definition = 'float64 [[[' WHERE topic_type LIKE 'their%'",
        "of an unknown kind": "UPDATE message_definitions SET encoding = 'protobuf' WHERE topic_type LIKE 'their%'",
        "no definitions at all, as of older recorders": "DROP TABLE message_definitions",
    }  # fmt: skip
    for how, statement in damages.items():
        with sqlite3.connect(path / "drive.db3") as database:
            database.execute(statement)
        assert seconds_read(path) == ([0], []), how


def test_an_mcap_without_chunks_may_be_in_any_order_and_of_any_profile(tmp_path: Path) -> None:
    writing = pytest.importorskip("mcap.writer", reason="mcap is not installed")
    source = record(tmp_path / "source", "mcap", clouds(3))
    with Bag(source) as bag:
        raw = [bytes(message.data) for _, message in bag.raw_clouds()]
    assert len(raw) == 3
    from rosbags.rosbag2 import Reader

    with Reader(source) as reader:
        messages = [(stamp, bytes(data)) for _, stamp, data in reader.messages()]
        definition = reader.connections[0].msgdef.data.encode()
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = writing.Writer(file, use_chunking=False)
        writer.start(profile="")
        other = writer.register_channel("/boxes", "protobuf", writer.register_schema("Boxes", "protobuf", b"\x00\xff"))
        channel = writer.register_channel("/points", "cdr", writer.register_schema(CLOUD, "ros2msg", definition))
        writer.add_message(other, START, b"\x08\x01", START)
        for stamp, data in reversed(messages):
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()
    assert seconds_read(path) == ([0, 1, 2], [])


@pytest.mark.parametrize("head", ["", "=" * 80 + "\nIDL: their_msgs/msg/Height\n"])
def test_definitions_in_idl(head: str) -> None:
    text = f"{head}module their_msgs {{ module msg {{ struct Height {{ double z; }}; }}; }};\n"
    channel = Channel(1, "/height", "their_msgs/msg/Height", text, is_idl=True)
    assert decode(channel, b"\0\1\0\0" + struct.pack("<d", 2.5)).z == 2.5
    with pytest.raises(UnreadableMessageError, match="/height"):
        decode(channel, b"\0\1\0\0\0")
