"""Which columns the points of a file have that does not say so itself, as a user names them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from svc_ros.core.errors import ConfigError

_TYPES = {"float32": "<f4", "float64": "<f8"}


@dataclass(frozen=True)
class Layout:
    """Columns of every point in their order, and the type of all of them in a binary file (text needs none).

    Raises ConfigError unless x, y and z are each named once and the type is float32 or float64.
    """

    names: tuple[str, ...]
    type_name: str = "float32"

    def __post_init__(self) -> None:
        if self.type_name not in _TYPES or any(self.names.count(name) != 1 for name in "xyz"):
            raise ConfigError(
                "columns: expected names in their order, x, y and z once each, and before them the type where it is "
                f"not float32, such as x,y,z,intensity or float64,x,y,z, found '{self!s:.80}'"
            )

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of one value."""
        return np.dtype(_TYPES[self.type_name])

    @property
    def xyz(self) -> list[int]:
        """Where x, y and z stand."""
        return [self.names.index(name) for name in "xyz"]

    @property
    def point_bytes(self) -> int:
        """Of all columns of a point."""
        return len(self.names) * self.dtype.itemsize

    def __str__(self) -> str:
        return " ".join([self.type_name, *self.names])


def read_layout(text: str) -> Layout:
    """Parse names in their order, apart by commas or blanks, after the type where it is not float32.

    Names are matched in small letters; what is called neither x, y nor z is skipped. ConfigError as for `Layout`.
    """
    words = text.lower().replace(",", " ").split()
    if words and words[0].startswith("float"):
        return Layout(tuple(words[1:]), words[0])
    return Layout(tuple(words))


KITTI = Layout(("x", "y", "z", "intensity"))
NUSCENES = Layout(("x", "y", "z", "intensity", "ring"))
