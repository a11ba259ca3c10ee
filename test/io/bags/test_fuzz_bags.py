"""Damaged bags of every format: read as far as they are intact, or refused by name; no crash, hang, endless memory."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from bag_recorder import record, three_clouds
from damaged_files import read_damaged

from svc_ros.io.bags import Bag

# Samples have 3 to 29 kB. What a header claims may be gigabytes, and is not taken; this is for libraries.
MOST_BYTES = 64 << 20
NUM_QUICK = {  # variants of a format that was tried share its code
    "mcap": 100, "db3": 100, "ros1": 100, "mcap_chunk_zstd": 20, "ros1_lz4": 20, "mcap_file_zstd": 20,
    "mcap_message_zstd": 20,
}  # fmt: skip


def read_all(path: Path) -> None:
    with Bag(path) as bag:
        for info in bag.cloud_topics:
            list(bag.raw_clouds(info.name))
        list(bag.transform_messages())
        str(bag.damage)


def read_with_metadata(sample: Path, metadata: Path) -> None:
    """Read the sample bag with a metadata.yaml of its own, in a folder of that file's name."""
    folder = metadata.parent / "bags" / metadata.name
    folder.mkdir(parents=True, exist_ok=True)
    for file in sample.glob("*.mcap"):
        (folder / file.name).write_bytes(file.read_bytes())
    (folder / "metadata.yaml").write_bytes(metadata.read_bytes())
    read_all(folder)


def check(tmp_path: Path, storage: str, seeds: range) -> None:
    path = record(tmp_path / "drive", storage, three_clouds)
    sample = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    folder = tmp_path / "damaged"
    folder.mkdir()
    counts = read_damaged(read_all, sample, folder, seeds, MOST_BYTES)
    assert counts.total() == len(seeds)
    assert min(counts["read"], counts["refused"]) > 0.05 * len(seeds)  # else nothing was tried


def check_metadata(tmp_path: Path, seeds: range) -> None:
    path = record(tmp_path / "drive", "mcap", three_clouds)
    folder = tmp_path / "damaged"
    folder.mkdir()
    counts = read_damaged(partial(read_with_metadata, path), path / "metadata.yaml", folder, seeds, MOST_BYTES)
    assert counts == {"read": len(seeds)}  # every file that it may name is beside it


@pytest.mark.parametrize("storage", sorted(NUM_QUICK))
def test_damaged_bags(tmp_path: Path, storage: str) -> None:
    check(tmp_path, storage, range(NUM_QUICK[storage]))


def test_damaged_metadata(tmp_path: Path) -> None:
    check_metadata(tmp_path, range(30))


@pytest.mark.slow
@pytest.mark.parametrize("storage", sorted(NUM_QUICK))
def test_ten_thousand_damaged_bags(tmp_path: Path, storage: str) -> None:
    check(tmp_path, storage, range(100, 10_100))


@pytest.mark.slow
def test_ten_thousand_damaged_metadata(tmp_path: Path) -> None:
    check_metadata(tmp_path, range(30, 10_030))
