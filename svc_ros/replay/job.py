"""What one bag is replayed with; small and picklable, so that it can travel to another process or machine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import svc_ros
from svc_ros.core.auto_preset import Choice, choose_preset
from svc_ros.core.config import AUTO, Config, unknown_name, with_values
from svc_ros.core.errors import InputError
from svc_ros.io.bags import Bag
from svc_ros.io.config_yaml import read_config
from svc_ros.io.maps.layout import CONFIG as MAP_CONFIG
from svc_ros.io.maps.layout import DESCRIPTION
from svc_ros.replay.clouds import BagPart, first_scans

MODES = ("pair", "scan_matching", "loop_closure", "localization")
WITH_ODOMETRY = ("loop_closure", "localization")

DECISIONS, RESULTS, TRAJECTORY, GRAPH = "decisions.jsonl", "results.mcap", "trajectory_tum.txt", "loops.g2o"
OPTIMIZED = "trajectory_optimized_tum.txt"
CONFIG, SUMMARY, REPORT = "config.yaml", "summary.json", "report.html"
_CHOSEN = ("mode", "start_s", "duration_s", "stride", "sensor_frame", "odometry_frame", "reference_frame")

Progress = Callable[[int, int], None]  # (clouds done, clouds expected); the second is exact once both are the same
StopRequest = Callable[[], bool]


@dataclass(frozen=True)
class ReplayJob:
    """One bag, how to replay it, and the folder `out` for everything that is found.

    preset: the name that the configuration started from, for the record; `auto`: `settled` chooses it by the first
    clouds, puts `values` (dotted names) over it in place of config, and keeps the choice in `chosen`; start_s,
    duration_s: [s] from the bag's begin; stride: in `pair` scan k + stride is registered to scan k, in the other modes
    every stride-th scan is taken;
    max_rate_hz: most scans a second of wall time, None for as fast as possible; sensor_frame: the sensor's frame where
    the clouds are in another one; odometry_frame: in `loop_closure` and `localization` odometry is where this frame
    sees the clouds on /tf, None for odometry by scan matching; reference: a TUM file with poses of `reference_frame`
    (None: of the clouds' frame); map_folder: in `localization` the map, whose configuration counts, with `values` over
    it; map_reference: a TUM file with poses of its scans in the reference's frame (None: the reference has them, too);
    with_input: copy clouds and transforms into results.mcap; resume: continue an interrupted run;
    report: write report.html; strict: refuse a bag that is damaged. Raises InputError.
    """

    bag: Path
    out: Path
    config: Config
    preset: str = "lidar_outdoor"
    mode: str = "pair"
    topic: str | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    stride: int = 1
    max_rate_hz: float | None = None
    sensor_frame: str | None = None
    odometry_frame: str | None = None
    reference: Path | None = None
    reference_frame: str | None = None
    with_input: bool = False
    resume: bool = False
    report: bool = True
    values: Mapping[str, Any] = field(default_factory=dict)
    chosen: Choice | None = None
    map_folder: Path | None = None
    map_reference: Path | None = None
    strict: bool = False

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InputError(unknown_name("--mode", self.mode, MODES))
        if self.max_rate_hz is not None and not self.max_rate_hz > 0.0:
            raise InputError(f"replay: expected a rate above 0 Hz, found {self.max_rate_hz:g}")
        if self.odometry_frame is not None and self.mode not in WITH_ODOMETRY:
            modes = " and ".join(WITH_ODOMETRY)
            raise InputError(f"--odometry-frame {self.odometry_frame}: only --mode {modes} take odometry")
        if (self.mode == "localization") != (self.map_folder is not None):
            raise InputError(f"--mode {self.mode}: expected --map with localization and with no other mode")
        if self.map_reference is not None and (self.map_folder is None or self.reference is None):
            raise InputError(f"--map-reference {self.map_reference}: expected --map and --reference with it")
        if self.reference_frame is not None and self.reference is None:
            raise InputError(f"--reference-frame {self.reference_frame}: expected --reference with it")

    def settled(self, bag: Bag, topic: str) -> ReplayJob:
        """The job with a configuration that fits the bag, or the map; as it is, unless the preset is `auto`.

        By the clouds that are first registered: the first pair, in the other modes the first one.
        """
        if self.map_folder is not None:
            config = with_values(read_config(self.map_folder / MAP_CONFIG, Config()), self.values)
            return replace(self, config=config, preset="map")
        if self.preset != AUTO:
            return self
        part = BagPart(topic, self.start_s, self.duration_s, self.stride, self.sensor_frame)
        chosen = choose_preset(first_scans(bag, part, 2 if self.mode == "pair" else 1))
        return replace(self, config=with_values(chosen.config, self.values), chosen=chosen)

    @property
    def base(self) -> str:
        """The preset that the configuration started from; of `auto` the one that it chose, none of a map."""
        if self.map_folder is not None:
            return ""
        return self.preset if self.chosen is None else self.chosen.preset

    @property
    def fixed_frame(self) -> str:
        """What pictures are drawn in where a decision has a place in it."""
        return "map" if self.map_folder is not None else self.odometry_frame or "odom"

    def told(self) -> dict[str, Any]:
        """For a summary: `preset`, and where `auto` chose, `chosen` with its reason."""
        return {"preset": self.preset, **({} if self.chosen is None else {"chosen": dict(self.chosen.summary())})}

    def identity(self) -> dict[str, Any]:
        """What decisions depend on besides the configuration: only a run with the same one may be continued."""
        chosen = {name: getattr(self, name) for name in _CHOSEN}
        bag = {"version": svc_ros.__version__, "bag": self.bag.name, "bag_bytes": _num_bytes(self.bag)}
        files = {"reference": self.reference, "map_reference": self.map_reference, "map": self._map_description}
        return {**bag, **chosen, **{f"{name}_sha256": _hash(path) for name, path in files.items()}}

    @property
    def _map_description(self) -> Path | None:
        """The file that tells of all others of the map."""
        return None if self.map_folder is None else self.map_folder / DESCRIPTION


def _hash(path: Path | None) -> str | None:
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def _num_bytes(path: Path) -> int:
    """Size of a bag, one file or a folder of them."""
    files = [path] if path.is_file() else sorted(path.rglob("*"))
    return sum(file.stat().st_size for file in files if file.is_file())
