"""Which of the topics and frames there are is meant, where none is named. No rclpy here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from svc_ros.core.errors import InputError
from svc_ros.io.clouds.livox import CLOUD_TYPES
from svc_ros.io.config_yaml import NODE_NAME

BASE_FRAME = "base_link"

SeenTopic = tuple[str, Sequence[str], int]  # full name, types, number of publishers


@dataclass(frozen=True)
class Choice:
    """A topic or a frame, and one line for a person on how it was found."""

    name: str
    why: str


def cloud_topics(seen: Iterable[SeenTopic]) -> list[str]:
    """Names of the topics on which somebody publishes clouds, but for what a node of ours shows; sorted."""
    return sorted(
        name
        for name, types, num_publishers in seen
        if num_publishers and CLOUD_TYPES & set(types) and NODE_NAME not in name.split("/")
    )


def choose_points(clouds: Sequence[str], usual: str, where: str, argument: str) -> Choice:
    """The topic of a stream of scans: the usual one (a full name) if it is among the clouds, else the only one.

    Without any it is the usual one all the same, for whoever comes later. where: they were looked for; argument: of the
    launch file, which names one. Raises InputError with the lines to write where several could be meant.
    """
    if usual in clouds:
        return Choice(usual, f"{argument}:={usual} ({where}, and it has the usual name)")
    if len(clouds) == 1:
        return Choice(clouds[0], f"{argument}:={clouds[0]} (the only clouds {where})")
    if not clouds:
        return Choice(usual, f"{argument}:={usual} (the usual name; there are no clouds {where} yet)")
    lines = "".join(f"\n  {argument}:={name}" for name in clouds)
    raise InputError(f"there are several topics with clouds {where}; name one of them:{lines}")


def describe_pair(clouds: Sequence[str], names: Mapping[str, str]) -> str:
    """One line on what mode pair waits for, full names by argument; which of other clouds is what, nobody can guess."""
    told = " ".join(f"{argument}:={name}" for argument, name in names.items())
    others = [name for name in clouds if name not in names.values()]
    if set(names.values()) <= set(clouds) or not others:
        return told
    return f"{told} (the usual names; source:= and target:= take others, of which there are {', '.join(others)})"


def choose_base(cloud_frame: str, parents: Mapping[str, str]) -> Choice | None:
    """`base_link`, if static transforms join the cloud's frame to it; parents: child to parent of those."""
    if cloud_frame == BASE_FRAME or not set(_upwards(cloud_frame, parents)) & set(_upwards(BASE_FRAME, parents)):
        return None
    return Choice(BASE_FRAME, f"base_frame:={BASE_FRAME} (static transforms join it to the clouds' {cloud_frame})")


def _upwards(frame: str, parents: Mapping[str, str]) -> list[str]:
    """The frame, its parent, and so on."""
    chain = [frame]
    while (parent := parents.get(chain[-1])) is not None and parent not in chain:
        chain.append(parent)
    return chain
