"""Which files are a recording, whatever its metadata.yaml says of them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from svc_ros.core.errors import InputError

METADATA = "metadata.yaml"
STORAGE_SUFFIXES = (".mcap", ".db3")
PACKED_SUFFIXES = (".zstd", ".zst")


@dataclass
class Recording:
    """Files in the order of their names; recorded: messages by topic as metadata.yaml counts them, empty without it.

    causes: what is wrong with metadata.yaml, or with what it names.
    """

    files: list[Path]
    recorded: dict[str, int] = field(default_factory=dict)
    causes: list[tuple[Path, str]] = field(default_factory=list)


def find_recording(path: Path) -> Recording:
    """The files of a bag: the one that is named, or those of a folder. InputError where there is none.

    What metadata.yaml names counts, as far as it is there. Its word on the storage does not: files tell that.
    """
    if not path.exists():
        raise InputError(f"{path}: bag not found")
    if not path.is_dir():
        return Recording([path])
    metadata, inside = path / METADATA, storage_files(path)
    if not metadata.exists():
        if not inside:
            expected = "expected a ROS 2 bag folder with metadata.yaml, .mcap or .db3 files"
            raise InputError(f"{path}: {expected}, found none{_hint(path)}")
        return Recording(inside)
    try:
        named, recorded = _read(metadata)
    except _MetadataError as error:
        if not inside:
            raise InputError(f"{metadata}: {error}, and no .mcap or .db3 file beside it{_hint(path)}") from None
        return Recording(inside, causes=[(metadata, f"{error}; read is every .mcap and .db3 file beside it")])
    missing = [file for file in named if not file.is_file()]
    names = ", ".join(file.name for file in missing)
    found = [file for file in named if file not in missing]
    if not found and not inside:
        raise InputError(f"{metadata}: expected the files that it names, found none of them: {names}")
    causes = [(metadata, f"it names files that are not there: {names}")] if missing else []
    return Recording(found or inside, recorded, causes)


def storage_files(folder: Path) -> list[Path]:
    """Files of ROS 2 recordings in a folder, split 10 after split 9."""
    return sorted((file for file in folder.iterdir() if _is_storage(file)), key=_natural)


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder is one recording by its metadata.yaml, or by files that are named like it, as rosbag2 does."""
    if not folder.is_dir():
        return False
    named = re.compile(rf"{re.escape(folder.resolve().name)}(_\d+)?\.")
    return (folder / METADATA).is_file() or any(named.match(file.name) for file in storage_files(folder))


class _MetadataError(Exception):
    pass


def _read(metadata: Path) -> tuple[list[Path], dict[str, int]]:
    """Files that metadata.yaml names, and messages by topic; _MetadataError where it says neither."""
    try:
        text = metadata.read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        raise _MetadataError("it cannot be read") from None
    if not text.strip():
        raise _MetadataError("it is empty")
    try:
        read: Any = yaml.safe_load(text)
        information = read["rosbag2_bagfile_information"]
        names = [PurePosixPath(name).name for name in information["relative_file_paths"]]
    except Exception:  # what broken YAML does to its parser has many names
        raise _MetadataError("expected YAML with rosbag2_bagfile_information and its files, found none") from None
    if not names:
        raise _MetadataError("it names no file")
    return [metadata.parent / name for name in dict.fromkeys(names)], _recorded(information)


def _recorded(information: Any) -> dict[str, int]:
    recorded: dict[str, int] = {}
    topics = information.get("topics_with_message_count")
    for topic in topics if isinstance(topics, list) else []:
        try:
            name, count = topic["topic_metadata"]["name"], topic["message_count"]
        except (KeyError, TypeError):
            continue
        if isinstance(name, str) and isinstance(count, int):
            recorded[name] = recorded.get(name, 0) + count
    return recorded


def _is_storage(file: Path) -> bool:
    name = file.with_suffix("") if file.suffix in PACKED_SUFFIXES else file
    return name.suffix in STORAGE_SUFFIXES and file.is_file()


def _natural(file: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]


def _hint(folder: Path) -> str:
    bags = sorted(file.name for file in folder.iterdir() if ".bag" in file.suffixes)
    return f"; open {bags[0]} itself" if bags else ""
