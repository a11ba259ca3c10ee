"""What a bag says of its messages, whichever format it has: topics, types and how much of them is lost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

_LISTED = 3  # causes of one file that are told; a worn disk has hundreds


class Channel(NamedTuple):
    """Messages of one type on one topic in one file; type: as ROS 2 writes it; definition: as recorded, or empty."""

    id: int
    topic: str
    type: str
    definition: str = ""
    is_idl: bool = False
    is_ros1: bool = False
    num_messages: int = 0


class TopicShare(NamedTuple):
    """How many messages of a topic can be read, of how many that were recorded (None: nothing tells)."""

    name: str
    num_read: int
    num_recorded: int | None

    def __str__(self) -> str:
        of = "" if self.num_recorded is None else f" of {self.num_recorded}"
        one = (self.num_read if self.num_recorded is None else self.num_recorded) == 1
        return f"{self.num_read}{of} message{'' if one else 's'} of {self.name}"


@dataclass(frozen=True)
class Damage:
    """What is wrong with one file of a bag, and what the whole bag lost by all of its damage."""

    path: Path
    causes: tuple[str, ...]
    topics: tuple[TopicShare, ...]

    def __str__(self) -> str:
        read = f"{', '.join(map(str, self.topics)) or 'no message'} read"
        more = len(self.causes) - _LISTED
        listed = [*self.causes[:_LISTED], *([f"and {more} more of this kind"] if more > 0 else [])]
        return f"{self.path}: {read}; {'; '.join(listed)}"

    def told(self) -> dict[str, Any]:
        """For a JSON result."""
        counts = {t.name: {"num_read": t.num_read, "num_recorded": t.num_recorded} for t in self.topics}
        return {"file": str(self.path), "message": str(self), "counts": counts}


def ros2_type_name(name: str) -> str:
    """`package/Type`, as ROS 1 writes it, as `package/msg/Type`."""
    package, _, rest = name.partition("/")
    return name if "/" in rest or not rest else f"{package}/msg/{rest}"
