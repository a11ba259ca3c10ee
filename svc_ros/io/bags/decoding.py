"""Recorded bytes as messages, by the definition that the bag has, or by a known one where it has none."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from svc_ros.io.bags.channels import Channel
from svc_ros.io.bags.decompression import ZSTD_MAGIC, decompress
from svc_ros.io.clouds.livox import LIVOX_DEFINITIONS, LIVOX_TYPES, cloud_from_cdr, cloud_from_points

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_MOST_BYTES = 1 << 31  # of one message


class UnreadableMessageError(Exception):
    """Bytes that are no message of the type that they should be."""


def decode(channel: Channel, raw: bytes) -> Any:
    """The message; Livox' own one as a cloud. UnreadableMessageError for anything else."""
    try:
        if not channel.is_ros1 and bytes(raw[:4]) == ZSTD_MAGIC:  # no serialised message begins like this
            raw = decompress(bytes(raw), "zstd", _MOST_BYTES)
        store = _types(channel.type, channel.definition, channel.is_idl, channel.is_ros1)
        if channel.type in LIVOX_TYPES:
            return _livox_cloud(store, channel, raw)
        return _message(store, channel, raw)
    except Exception as error:  # what is wrong with bytes has a type for each way to trip over them
        raise UnreadableMessageError(channel.topic) from error


@lru_cache(maxsize=64)
def _types(name: str, definition: str, is_idl: bool, is_ros1: bool) -> Typestore:
    """Each definition is worked out once, and only where a message has it."""
    return _recorded_types(name, definition, is_idl) or _known_types(is_ros1)


def _message(store: Typestore, channel: Channel, raw: bytes) -> Any:
    deserialise = store.deserialize_ros1 if channel.is_ros1 else store.deserialize_cdr
    return deserialise(raw, channel.type)


def _livox_cloud(store: Typestore, channel: Channel, raw: bytes) -> Any:
    known = _known_types(is_ros1=False)
    if _layout(store, channel.type) != _layout(known, channel.type):
        return cloud_from_points(_message(store, channel, raw))
    data = known.ros1_to_cdr(raw, channel.type) if channel.is_ros1 else raw
    cloud = cloud_from_cdr(bytes(data))
    return replace(cloud, data=np.frombuffer(cloud.data, np.uint8))


def _layout(store: Typestore, name: str) -> str:
    """Names and types of a Livox message's fields, and of its points'."""
    package = name.partition("/")[0]
    return str([store.fielddefs[name][1], store.fielddefs[f"{package}/msg/CustomPoint"][1]])


def _recorded_types(name: str, definition: str, is_idl: bool) -> Typestore | None:
    """The types of a recorded definition; None where it is none, or damaged."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not definition:
        return None
    store, line = get_typestore(Stores.EMPTY), "=" * 80 + "\n"
    try:
        types = {} if is_idl else get_types_from_msg(definition, name)
        for text in filter(str.strip, definition.split(line) if is_idl else ()):
            types |= get_types_from_idl(text.partition("\n")[2] if text.startswith("IDL: ") else text)
        store.register(types)
        return store if name in store.fielddefs else None
    except Exception:  # of its parser, of its grammar, of the code that it writes
        return None


@lru_cache(maxsize=2)
def _known_types(is_ros1: bool) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    for name, text in LIVOX_DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store
