"""Bags as bad disks, full cards and killed recorders leave them: what is intact is read, what is lost is told."""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
from backports import zstd
from bag_damage import (
    NUM_CLOUDS,
    chunk_places,
    chunked_mcap,
    chunked_ros1,
    clouds,
    cut,
    ends_of_clouds,
    overwrite,
    seconds_read,
)
from bag_recorder import START, S, points_of, record, three_clouds

from svc_ros.core.errors import InputError
from svc_ros.io.bags import Bag
from svc_ros.io.bags.decompression import decompress

ALL = list(range(NUM_CLOUDS))


def file_of(path: Path) -> Path:
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))


# Cut


@pytest.mark.parametrize("storage", ["mcap", "ros1"])
@pytest.mark.parametrize("share", [0.4, 0.55, 0.7, 0.85, 0.97])
def test_a_cut_bag_gives_every_cloud_before_the_cut(tmp_path: Path, storage: str, share: float) -> None:
    path = record(tmp_path / "drive", storage, three_clouds)
    file = file_of(path)
    keep = int(share * file.stat().st_size)
    num = sum(end <= keep for end in ends_of_clouds(file, 3))
    cut(file, keep)
    if not num:
        with pytest.raises(InputError, match=rf"{file.name}: .*the file ends after {keep} bytes"):
            seconds_read(path)
        return
    read, told = seconds_read(path)
    assert read == list(range(num))
    assert len(told) == 1
    of = " of 3 messages" if storage == "mcap" else f"( of {num})? messages?"  # no metadata.yaml tells of a ROS 1 bag
    assert re.search(rf"drive\.\w+: {num}{of} of /points.* read; the file ends after {keep} ", told[0])


@pytest.mark.parametrize(("suffix", "compression"), [("mcap", "zstd"), ("mcap", "lz4"), ("bag", "lz4"), ("bag", "bz2")])
def test_of_a_cut_compressed_bag_whole_chunks_are_read(tmp_path: Path, suffix: str, compression: str) -> None:
    path = (chunked_mcap if suffix == "mcap" else chunked_ros1)(tmp_path / f"drive.{suffix}", compression)
    start, length = chunk_places(path)[4]
    read, told = seconds_read(cut(path, start + length // 2))
    assert read == [0, 1, 2, 3]
    assert "4 messages of /points read; the file ends after" in told[0]
    assert "in the middle of a chunk" in told[0]


@pytest.mark.parametrize("suffix", ["mcap", "bag"])
def test_a_bag_cut_between_chunks_is_told(tmp_path: Path, suffix: str) -> None:
    path = (chunked_mcap if suffix == "mcap" else chunked_ros1)(tmp_path / f"drive.{suffix}")
    read, told = seconds_read(cut(path, chunk_places(path)[3][0]))
    assert read == [0, 1, 2]
    assert f"ends after {path.stat().st_size} bytes, before its index" in told[0]


def test_a_bag_whose_index_is_cut_loses_nothing_and_says_so(tmp_path: Path) -> None:
    path = chunked_mcap(tmp_path / "drive.mcap")
    read, told = seconds_read(cut(path, path.stat().st_size - 20))
    assert read == ALL
    assert "6 of 6 messages of /points read; the file ends after" in told[0]
    assert "in the middle of its index" in told[0]


@pytest.mark.parametrize("has_open_chunk", [False, True])
def test_a_ros1_recording_that_was_not_closed(tmp_path: Path, has_open_chunk: bool) -> None:
    """The recorder writes where the index is, and how long the last chunk is, when it closes them."""
    path = chunked_ros1(tmp_path / "drive.bag")
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + 10
    index_at = struct.unpack_from("<Q", data, at)[0]
    data[at : at + 8], keep = bytes(8), index_at
    if has_open_chunk:
        start, length = chunk_places(path)[-1]
        header = struct.unpack_from("<I", data, start)[0]
        size_at = data.index(b"size=", start) + 5
        data[size_at : size_at + 4] = data[start + 4 + header : start + 8 + header] = bytes(4)
        keep = start + 8 + header + length
    active = tmp_path / "drive.bag.active"
    active.write_bytes(bytes(data[:keep]))
    read, told = seconds_read(active)
    assert read == ALL
    assert told == [f"{active}: 6 messages of /points read; its recording was not closed"]


# Damage in the middle


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_damaged_chunk_is_lost_and_counted_and_those_behind_it_are_read(tmp_path: Path, compression: str) -> None:
    path = chunked_mcap(tmp_path / "drive.mcap", compression)
    start, length = chunk_places(path)[2]
    read, told = seconds_read(overwrite(path, start + length // 2, 5))
    assert read == [0, 1, 3, 4, 5]
    assert f"5 of 6 messages of /points read; the chunk at byte {start} is damaged: " in told[0]
    with pytest.raises(InputError, match=rf"drive\.mcap: 5 of 6 .*byte {start}"), Bag(path, strict=True) as bag:
        list(bag.scans())


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_a_damaged_chunk_of_ros1_is_lost_and_counted(tmp_path: Path, compression: str) -> None:
    path = chunked_ros1(tmp_path / "drive.bag", compression)
    start, length = chunk_places(path)[2]
    read, told = seconds_read(overwrite(path, start + 60, length // 2))
    assert read == [0, 1, 3, 4, 5]
    cause = f"the chunk at byte {start} is damaged: what it holds is no {compression}"
    assert f"5 of 6 messages of /points read; {cause}" in told[0]


@pytest.mark.parametrize("suffix", ["mcap", "bag"])
def test_after_a_damaged_record_the_next_chunk_is_found(tmp_path: Path, suffix: str) -> None:
    path = (chunked_mcap if suffix == "mcap" else chunked_ros1)(tmp_path / f"drive.{suffix}", "none")
    places = chunk_places(path)
    read, told = seconds_read(overwrite(path, places[2][0], 40))
    assert read == [0, 1, 3, 4, 5]
    assert f"5 of 6 messages of /points read; bytes {places[2][0]} to {places[3][0]} are damaged" in told[0]
    cut(path, places[5][0] - 1)  # now there is no index that counts
    read, told = seconds_read(path)
    assert read == [0, 1, 3, 4]
    assert "4 messages of /points read; bytes" in told[0]


def test_a_tail_of_zeros_is_no_message_and_no_index(tmp_path: Path) -> None:
    """As a file system leaves it that had room for the data and lost power before they came."""
    path = chunked_mcap(tmp_path / "drive.mcap", "none", enable_crcs=False)
    data_at = chunk_places(path)[4][0] + 60
    read, told = seconds_read(overwrite(path, data_at, path.stat().st_size - data_at, 0))
    assert read == [0, 1, 2, 3]
    assert "4 messages of /points read; " in told[0]
    assert re.search(r"its \d+ bytes from byte \d+ on are damaged", told[0])


def test_zeros_in_a_chunk_without_checksum_are_no_silence(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", three_clouds)
    start, length = chunk_places(file_of(path))[0]
    overwrite(file_of(path), start + length // 2, length // 4, 0)
    read, told = seconds_read(path)
    assert read == [0]
    assert "1 of 3 messages of /points" in told[0]


def test_messages_that_are_none_are_left_out_and_counted(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "db3", clouds(3))
    with sqlite3.connect(file_of(path)) as database:
        database.execute("UPDATE messages SET data = zeroblob(40) WHERE id = 2")
    read, told = seconds_read(path)
    assert read == [0, 2]
    assert "2 of 3 messages of /points read; /points has 1 damaged" in told[0]


PACKERS: dict[str, Any] = {"zstd": zstd.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}


@pytest.mark.parametrize("name", sorted(PACKERS))
def test_a_size_that_a_chunk_only_claims_is_not_believed(name: str) -> None:
    data = bytes(range(256)) * 40
    tracemalloc.start()
    try:
        assert decompress(PACKERS[name](data), name, 1 << 40) == data
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()
    assert decompress(PACKERS[name](data), name, 1000) == data[:1000]
    with pytest.raises(ValueError, match=name):
        decompress(b"\xa5" * 100, name, 1000)


# SQLite


def unclosed_db3(tmp_path: Path, num_in_log: int) -> Path:
    """What is on disk while a recorder with a write-ahead log runs: three clouds in the file, others in the log."""
    whole = record(tmp_path / "whole", "db3", clouds(3 + num_in_log))
    with sqlite3.connect(file_of(whole)) as database:
        rows = database.execute("SELECT * FROM messages WHERE id > 3").fetchall()
        database.execute("DELETE FROM messages WHERE id > 3")
    database = sqlite3.connect(file_of(whole))
    database.execute("PRAGMA journal_mode=WAL")
    database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    database.commit()
    database.execute("INSERT INTO messages VALUES (99, 1, 99, x'00')")  # of a transaction that never ends
    folder = tmp_path / "drive"
    folder.mkdir()
    for end in ("", "-wal"):
        data = file_of(whole).with_name(f"whole.db3{end}").read_bytes()
        (folder / f"drive.db3{end}").write_bytes(data)
    database.close()
    return folder


def test_what_is_in_the_log_beside_a_db3_is_read_and_nothing_is_changed(tmp_path: Path) -> None:
    folder = unclosed_db3(tmp_path, 2)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert seconds_read(folder) == ([0, 1, 2, 3, 4], [])
    assert seconds_read(folder / "drive.db3") == ([0, 1, 2, 3, 4], [])
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_an_unfinished_transaction_is_told(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "db3", clouds(3))
    (path / "drive.db3-journal").write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" * 64)
    read, told = seconds_read(path)
    assert read == [0, 1, 2]
    assert "its last transaction was not finished (drive.db3-journal)" in told[0]


@pytest.mark.parametrize("lost_pages", [2, 12, 30])
def test_a_cut_db3_gives_the_rows_before_the_cut(tmp_path: Path, lost_pages: int) -> None:
    path = record(tmp_path / "drive", "db3", clouds(120))
    file, whole = file_of(path), file_of(path).stat().st_size
    cut(file, whole - lost_pages * 4096)
    read, told = seconds_read(path)
    # Each page holds three to five of these clouds, and the index of times lies between them.
    assert read == list(range(len(read)))
    assert 120 - 5 * lost_pages <= len(read) < 120
    assert f"{len(read)} of 120 messages of /points read; its rows after message {len(read)} are damaged" in told[0]
    assert f"the file ends after {whole - lost_pages * 4096} of {whole} bytes" in told[0]


def test_behind_a_damaged_page_a_db3_is_read_on(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "db3", clouds(60))
    file = file_of(path)
    page = file.read_bytes().index(points_of(30).tobytes()) // 4096
    read, told = seconds_read(overwrite(path=file, start=page * 4096, length=4096))
    assert 54 <= len(read) < 60
    assert {0, 59} <= set(read)
    assert f"{len(read)} messages of /points read; {60 - len(read)} rows of messages are damaged" in told[0]


# Several files


def split(tmp_path: Path, storage: str = "mcap") -> Path:
    """Two clouds in each of three splits, as rosbag2 names them."""
    folder = tmp_path / "drive"
    folder.mkdir()
    names = []
    for k in range(3):
        part = record(tmp_path / f"part{k}", storage, clouds(2, 2 * k))
        names.append(f"drive_{k}.{storage}")
        file_of(part).rename(folder / names[-1])
    text = (tmp_path / "part0" / "metadata.yaml").read_text()
    listed = "".join(f"  - {name}\n" for name in names)
    text = re.sub(r"  relative_file_paths:\n  - .*\n", f"  relative_file_paths:\n{listed}", text)
    text = text.replace("message_count: 2", "message_count: 6")
    (folder / "metadata.yaml").write_text(text)
    return folder


@pytest.mark.parametrize("storage", ["mcap", "db3"])
def test_several_splits_are_one_bag(tmp_path: Path, storage: str) -> None:
    assert seconds_read(split(tmp_path, storage)) == (ALL, [])


@pytest.mark.parametrize(
    ("has_a_cloud", "num", "cause"),
    [(True, 5, "the file ends after {size} bytes in the middle of a chunk"),
     (False, 4, "cannot be read as a bag: it is empty")],
)  # fmt: skip
def test_the_last_split_is_damaged(tmp_path: Path, has_a_cloud: bool, num: int, cause: str) -> None:
    folder = split(tmp_path)
    last = folder / "drive_2.mcap"
    cut(last, last.read_bytes().index(points_of(4).tobytes()) + points_of(4).nbytes + 4 if has_a_cloud else 0)
    read, told = seconds_read(folder)
    assert read == ALL[:num]
    assert told == [f"{last}: {num} of 6 messages of /points read; {cause.format(size=last.stat().st_size)}"]
    with pytest.raises(InputError, match=r"drive_2\.mcap"), Bag(folder, strict=True):
        pass


def test_a_metadata_that_counts_more_than_its_files_hold(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", clouds(2))
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 2", "message_count: 5"))
    read, told = seconds_read(path)
    assert read == [0, 1]
    assert told == [f"{path}: 2 of 5 messages of /points read; its metadata.yaml counts more messages of /points"]


# Strict


def test_strict_refuses_at_once_what_is_known_at_once_and_takes_what_is_intact(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", three_clouds)
    with Bag(path, strict=True) as bag:
        assert len(list(bag.scans())) == 3
    cut(file_of(path), 3000)
    with pytest.raises(InputError, match=r"drive\.mcap: .* of 3 messages .* ends after 3000 bytes"):
        Bag(path, strict=True).__enter__()


def test_damage_is_told_of_a_bag_that_is_closed_again(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", clouds(3))
    keep = ends_of_clouds(file_of(path), 3)[1]
    cut(file_of(path), keep)
    with Bag(path) as bag:
        assert bag.num_scans() == 2
        assert bag.span_ns == (START, START + S)
    (damage,) = bag.damage
    assert damage.told() == {
        "file": str(file_of(path)),
        "message": str(damage),
        "counts": {"/points": {"num_read": 2, "num_recorded": 3}},
    }


# The samples of others, where they are


@pytest.mark.parametrize(
    ("name", "num_intact", "num_recorded"),
    [("cut_mcap", None, 8), ("cut_ros1.bag", None, None), ("no_metadata", 8, 8), ("storage_id_empty", 8, 8),
     ("livox_custom", 4, 4)],
)  # fmt: skip
def test_the_examples(shared_data: Path, name: str, num_intact: int | None, num_recorded: int | None) -> None:
    path = shared_data / "inputs" / "bags" / name
    if not path.exists():
        pytest.skip(f"no bag {path}")
    if num_intact is None:
        num_intact = num_whole_messages(file_of(path))
    with Bag(path) as bag:
        assert len(list(bag.scans())) == num_intact
        damage = bag.damage
    assert bool(damage) == (num_intact != num_recorded)
    if damage:
        assert (damage[0].topics[0].num_read, damage[0].topics[0].num_recorded) == (num_intact, num_recorded)


def num_whole_messages(path: Path) -> int:
    """Messages that end before the file does, by the lengths in its one uncompressed chunk and nothing else."""
    data = path.read_bytes()
    (start, _), *_ = chunk_places(path)
    num = 0
    if path.suffix == ".mcap":
        at = start + 9 + 40
        while at + 9 <= len(data):
            op, length = struct.unpack_from("<BQ", data, at)
            at += 9 + length
            num += op == 5 and at <= len(data)
        return num
    at = start + 8 + struct.unpack_from("<I", data, start)[0]
    while at + 4 <= len(data):
        header = struct.unpack_from("<I", data, at)[0]
        is_message = b"op=\x02" in data[at : at + 4 + header]
        at += 8 + header + struct.unpack_from("<I", data, at + 4 + header)[0]
        num += is_message and at <= len(data)
    return num
