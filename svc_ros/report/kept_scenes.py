"""Scenes as a page carries them: coordinates in 16 bits, as text, with what the picture leaves out in numbers."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.report.scenes import Scene, SideView

PARTS = ("points", "clear", "blocked", "denied")
_COUNTS = ("num_points", "num_lines", "num_blocked", "num_denied", "num_seen")
_MOST = 32767


def scene_to_json(scene: Scene) -> dict[str, Any]:
    """One scene as JSON: `target` and `source`, each part the base64 of little-endian int16 x y z, times `step_m`.

    The step is the scene's largest coordinate in 32767 parts: 3 mm at 100 m.
    """
    step_m = _largest(scene) / _MOST
    return {
        "index": scene.index,
        "step_m": step_m,
        "placed": scene.T_target_source is not None,
        "target": _side_to_json(scene.target, step_m),
        "source": _side_to_json(scene.source, step_m),
    }


def _largest(scene: Scene) -> float:
    arrays = [scene.target.origin, scene.source.origin]
    arrays += [getattr(side, part) for side in (scene.target, scene.source) for part in PARTS]
    return max(1.0, *(float(np.abs(array).max(initial=0.0)) for array in arrays))


def _side_to_json(side: SideView, step_m: float) -> dict[str, Any]:
    texts = {part: _text(getattr(side, part), step_m) for part in PARTS}
    numbers = {name: getattr(side, name) for name in _COUNTS}
    return {"origin": [round(float(value), 4) for value in side.origin], **numbers, **texts}


def _text(points: NDArray[np.float32], step_m: float) -> str:
    return base64.b64encode(np.rint(points / step_m).astype("<i2").tobytes()).decode("ascii")
