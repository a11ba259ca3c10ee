"""The worlds by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from svc_ros.core.config import unknown_name
from svc_ros.core.errors import ConfigError
from svc_ros.simulation import indoor, street
from svc_ros.simulation.world import Scene, SceneConfig

SCENES: dict[str, Callable[[np.random.Generator, SceneConfig], Scene]] = {
    "street": street.build_street,
    "indoor": indoor.build_indoor,
    "corridor": indoor.build_bare_corridor,
    "corridor_features": indoor.build_furnished_corridor,
}


def build_scene(name: str, rng: np.random.Generator, config: SceneConfig | None = None) -> Scene:
    """Build the named world. All of it follows from the generator; an unknown name raises ConfigError.

    street: houses, side streets, cars, trees; indoor: halls and rooms along a corridor; corridor: straight, without a
    feature for 200 m, so that the motion along it cannot be observed; corridor_features: the same with door frames,
    boxes and pillars.
    """
    if name not in SCENES:
        raise ConfigError(unknown_name("scene", name, list(SCENES)))
    return SCENES[name](rng, config or SceneConfig())
