"""Takes the place of tf2_ros where it is not installed: a buffer that answers with what a test says."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.ros.topics.conversions import header


def tf2_module(look_up: Callable[[str, str, int], Any]) -> ModuleType:
    """The module; look_up: the message for (target, source, stamp_ns), or what tf2 raises."""

    class Buffer:
        def lookup_transform(self, target, source, time, _timeout):
            return look_up(target, source, time.nanoseconds)

        def clear(self): ...

    class TransformListener:
        def __init__(self, _buffer, _node): ...
        def unregister(self): ...

    module = ModuleType("tf2_ros")
    module.Buffer, module.TransformListener = Buffer, TransformListener
    return module


def transform_of(T: np.ndarray, stamp_ns: int = 0) -> Any:
    """What tf2 says of a pose (4, 4)."""
    turn = dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat().tolist(), strict=True))
    shift = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    transform = SimpleNamespace(translation=SimpleNamespace(**shift), rotation=SimpleNamespace(**turn))
    return SimpleNamespace(transform=transform, header=header(stamp_ns, ""))
