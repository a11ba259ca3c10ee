"""The node's parameters: the config's own fields, found by walking it, and the few that only a node has.

`preset` is read first; its values are the defaults of all others. With `auto` these are lidar_outdoor's until the first
clouds decide (see `first_choice`); what nobody has set then follows the choice. A change is checked as a whole
configuration before it is taken, and applies to the next pair.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from svc_ros.core.auto_preset import Choice
from svc_ros.core.config import AUTO, PRESETS, Config, FieldInfo, preset, unknown_name, values_of, walk, with_values
from svc_ros.core.errors import ConfigError, MissingDependencyError
from svc_ros.core.matches.descriptors import load_descriptors
from svc_ros.ros.start_notes import differences, unknown_parameter, unmatched_overrides
from svc_ros.ros.topics.descriptors import parameter_descriptor, type_text

MODES = ("pair", "scan_matching", "loop_closure", "localization")
ODOMETRY = ("own", "topic", "tf")
TOLD_BY = ("topic", "tf", "none")
EDGES = ("none", "rtabmap", "pose_graph_tools")
_COVARIANCES = (
    "position_covariance", "orientation_covariance", "linear_velocity_covariance", "angular_velocity_covariance"
)  # fmt: skip
_FOREIGN = ("use_sim_time", "qos_overrides.", "start_type_description_service")  # declared by rclpy itself
_LEAST_CAPACITY = 8
OF_MAPS = ("preprocess.", "features.")  # what scans and keyframes of a map have in common


@dataclass(frozen=True)
class NodeSettings:
    """What the node needs beside the registration's config; units are in the names or in `OWN`."""

    mode: str = "pair"
    max_skew: float = 0.05
    pair_timeout: float = 10.0  # a lost part of a big cloud is repaired every 3 s by the middleware
    queue_size: int = 1
    process_every: bool = False
    sensor_frame: str = ""
    sensor_origin: tuple[float, ...] = (0.0, 0.0, 0.0)
    tf_timeout: float = 0.2
    publish_tf: bool = False
    tf_child_frame: str = ""
    invert_odom_tf: bool = False
    map_frame: str = ""
    transform_tolerance: float = 0.2
    odom_frame: str = "odom"
    base_frame: str = ""
    position_covariance: float = 0.0
    orientation_covariance: float = 0.0
    linear_velocity_covariance: float = 0.0
    angular_velocity_covariance: float = 0.0
    odometry: str = "own"
    graph_file: str = ""
    map_folder: str = ""
    told_by: str = "topic"
    publish_initialpose: bool = False
    edges: str = "none"
    autostart: bool = True

    def __post_init__(self) -> None:
        for name, known in (("mode", MODES), ("odometry", ODOMETRY), ("edges", EDGES), ("told_by", TOLD_BY)):
            if getattr(self, name) not in known:
                raise ConfigError(unknown_name(name, getattr(self, name), known))
        if len(self.sensor_origin) != 3:
            raise ConfigError(f"sensor_origin: expected 3 numbers [m], found {len(self.sensor_origin)}")
        if self.sensor_frame and any(self.sensor_origin):
            raise ConfigError("sensor_frame and sensor_origin exclude each other: set one of them")
        self._check_odometry()
        self._check_map_frame()
        self._check_localization()
        is_loop_closure = self.mode == "loop_closure"
        if self.publish_tf and is_loop_closure:
            raise ConfigError("publish_tf: mode loop_closure tells loops between old scans, which are no frames")
        if (self.graph_file or self.edges != "none") and not is_loop_closure:
            raise ConfigError(f"graph_file and edges belong to mode loop_closure, found mode {self.mode}")

    def _check_odometry(self) -> None:
        """What only ~/odometry and its /tf have."""
        wanted = [name for name in (*_COVARIANCES, "invert_odom_tf") if getattr(self, name)]
        if wanted and self.mode != "scan_matching":
            raise ConfigError(f"{wanted[0]} belongs to mode scan_matching, found mode {self.mode}")
        if self.invert_odom_tf and self.tf_child_frame:
            raise ConfigError("invert_odom_tf and tf_child_frame exclude each other: the child is odom_frame then")

    def _check_map_frame(self) -> None:
        """What telling where odometry stands in a map asks for."""
        if self.map_frame and self.mode not in ("pair", "localization"):
            raise ConfigError(f"map_frame belongs to mode pair or localization, found mode {self.mode}")
        if self.map_frame and self.publish_tf and self.mode == "pair":
            raise ConfigError("map_frame and publish_tf exclude each other: the source's frame would have two parents")
        if self.map_frame and self.sensor_frame and self.mode == "pair":
            why = "where the sensor of a stored cloud stood is not where the robot's stands now: set sensor_origin"
            raise ConfigError(f"map_frame and sensor_frame exclude each other: {why}")
        if self.frame_of_map == self.odom_frame:
            raise ConfigError(f"map_frame and odom_frame have to differ, found {self.odom_frame!r} for both")

    def _check_localization(self) -> None:
        """What finding the sensor in a map asks for, and what nothing else has."""
        if self.mode != "localization":
            wanted = [name for name in ("map_folder", "publish_initialpose") if getattr(self, name)]
            if wanted:
                raise ConfigError(f"{wanted[0]} belongs to mode localization, found mode {self.mode}")
            return
        if not self.map_folder:
            raise ConfigError("map_folder: mode localization needs the folder of a map (svc_ros map makes one)")
        if self.publish_tf and self.odometry == "own":
            raise ConfigError("publish_tf: mode localization tells where odometry stands, set odometry to topic or tf")
        if self.publish_tf and self.told_by == "tf":
            raise ConfigError("publish_tf and told_by:=tf exclude each other: the node would judge what it says itself")
        if self.publish_initialpose and self.told_by == "topic":
            raise ConfigError("publish_initialpose and told_by:=topic exclude each other: both are topic initialpose")

    @property
    def max_skew_ns(self) -> int:
        """Largest difference of the stamps of a pair [ns]."""
        return round(self.max_skew * 1e9)

    @property
    def frame_of_map(self) -> str:
        """The map's frame; empty where there is no map."""
        return self.map_frame or ("map" if self.mode == "localization" else "")

    @property
    def sends_map_frame(self) -> bool:
        """Whether it is told on /tf where odometry stands in the map."""
        return self.publish_tf if self.mode == "localization" else bool(self.map_frame)

    @property
    def capacity(self) -> int:
        """Pairs or scans that may wait; in loop closure for the worker, and as many for a thread that judges.

        There a motion that is missing breaks the way and a loop is as good later, so more of them may wait.
        """
        return max(self.queue_size, _LEAST_CAPACITY) if self.mode == "loop_closure" else self.queue_size


def _own(name: str, text: str, unit: str = "", low: float | None = None, high: float | None = None,
         choices: tuple[str, ...] = ()) -> FieldInfo:  # fmt: skip
    default = next(f.default for f in dataclasses.fields(NodeSettings) if f.name == name)
    return FieldInfo(name, default, text, unit, low, high, choices)  # type: ignore[arg-type]


OWN: tuple[FieldInfo, ...] = (
    _own("mode", "what the node does with its inputs", choices=MODES),
    _own("max_skew", "largest difference of the stamps of a pair, and of a cloud and its odometry", "s", 0.0, 10.0),
    _own("pair_timeout", "clouds without a partner are given up after this much silence; 0: never", "s", 0.0, 3600.0),
    _own("queue_size", "pairs or scans that may wait (loops: 8 at least); the oldest gives way", "", 1, 10_000),
    _own("process_every", "compute every pair or scan, however long the queue grows (replay)"),
    _own("sensor_frame", "frame of the sensor, where clouds are in another; '': the cloud's own frame"),
    _own("sensor_origin", "where the sensor stands in the cloud's frame, if no TF says it", "m"),
    _own("tf_timeout", "how long to wait for a transform, or for odometry behind a cloud's stamp", "s", 0.0, 60.0),
    _own("publish_tf", "publish accepted transforms on /tf too; localization: where odom_frame stands in the map"),
    _own("odom_frame", "frame that scan matching tells poses in, and that odometry from elsewhere is in"),
    _own("base_frame", "frame of the robot: scan matching and localization tell where it is; '': the cloud's frame"),
    _own("position_covariance", "variance that ~/odometry tells of x, y and z; 0: the computed one", "m^2", 0.0, 1e6),
    _own("orientation_covariance", "variance that it tells of turns; 0: the computed one", "rad^2", 0.0, 1e3),
    _own("linear_velocity_covariance", "variance of its speeds; 0: the computed one", "m^2/s^2", 0.0, 1e6),
    _own("angular_velocity_covariance", "variance of its turn rates; 0: the computed one", "rad^2/s^2", 0.0, 1e3),
    _own("odometry", "of loops and localization: own motion, topic odom, or TF from odom_frame", choices=ODOMETRY),
    _own("graph_file", "loop closure writes its pose graph here (g2o), on reset and at the end; '': nowhere"),
    _own("edges", "loops go to this back end, too: none, rtabmap, pose_graph_tools", choices=EDGES),
    _own("autostart", "configure and activate at the start; false: wait for lifecycle transitions"),
    _own("invert_odom_tf", "scan matching's /tf has odom_frame as the child of the robot's frame, not as its parent"),
    _own("map_frame", "pair sends where odom_frame stands in this on /tf, '': not; the map of localization, '': map"),
    _own("transform_tolerance", "so far ahead of the present that transform is dated", "s", 0.0, 10.0),
    _own("map_folder", "localization: the folder of the map, as svc_ros map makes it"),
    _own("told_by", "localization judges poses of others: on topic initialpose, by TF, or none", choices=TOLD_BY),
    _own("publish_initialpose", "localization tells others where they are, once each time that they are lost"),
    _own("tf_child_frame", "child frame on /tf; '': the source's frame, FRAME/source if that is the target's too"),
)
_READ_ONLY = (
    "preset", "mode", "publish_tf", "map_frame", "odom_frame", "base_frame", "odometry", "graph_file", "edges",
    "autostart", "map_folder", "told_by", "publish_initialpose",
)  # fmt: skip


class NodeParameters:
    """Declares every parameter of `node` and keeps `config` and `settings` up to date.

    Raises ConfigError on values that are refused at start, MissingDependencyError for a descriptor that cannot be
    imported. `config` and `settings` are frozen and replaced as a whole, so another thread may read them at any time.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.preset_name = self._declare(
            FieldInfo("preset", "lidar_outdoor", "defaults of all other values", "", None, None, (*PRESETS, AUTO))
        )
        self._named = self.preset_name
        self.choice: Choice | None = None
        self._given = set(getattr(node, "_parameter_overrides", {}))
        base = preset("lidar_outdoor" if self.preset_name == AUTO else self.preset_name)
        self.config: Config = with_values(base, {info.name: self._declare(info) for info in walk(base)})
        load_descriptors(self.config)
        self.settings = _settings(NodeSettings(), {info.name: self._declare(info) for info in OWN})
        self._known = [*values_of(base), *(info.name for info in OWN), "preset"]
        self._defaults = {**values_of(base), **{info.name: info.default for info in OWN}}
        node.add_on_set_parameters_callback(self._check_change)
        node.add_post_set_parameters_callback(self._apply_change)

    @property
    def awaits_choice(self) -> bool:
        """True while the preset is `auto` and nothing has been chosen."""
        return self.preset_name == AUTO and self.choice is None

    def take(self, choice: Choice) -> None:
        """Make the choice's values those of all parameters that were set neither at the start nor since.

        Raises ConfigError, and changes nothing, where they do not go with those that were set.
        """
        self._take(choice.config, f"preset auto chose {choice.preset}")
        self.choice = choice

    def take_map(self, config: Config) -> None:
        """The same with the values that a map was made with, in place of a preset's.

        Raises ConfigError also where a value was set, by name or by a preset, that would prepare scans otherwise.
        """
        by_preset = {} if "preset" not in self._given or self._named == AUTO else values_of(preset(self._named))
        by_name = {name: value for name, value in values_of(self.config).items() if name in self._given}
        for name, wanted in values_of(config).items():
            found = {**by_preset, **by_name}.get(name, wanted)
            if name.startswith(OF_MAPS) and found != wanted:
                whose = "" if name in by_name else f" by preset {self._named}"
                raise ConfigError(f"{name}: expected {wanted}, which the map was made with, found {found}{whose}")
        self._take(config, "map_folder")
        self.preset_name = "map"

    def _take(self, config: Config, why: str) -> None:
        given, now = set(self._given), values_of(self.config)
        wanted = {name: value for name, value in values_of(config).items() if name not in given}
        changed = [Parameter(name, value=value) for name, value in wanted.items() if value != now[name]]
        result = self._node.set_parameters_atomically(changed)
        self._given = given  # what was taken may be replaced by what is taken next
        if not result.successful:
            raise ConfigError(f"{why}: {result.reason}")

    def unknown_overrides(self) -> list[str]:
        """One line for each parameter that was given from outside and that the node does not have."""
        given = getattr(self._node, "_parameter_overrides", {})
        foreign = [n for n in given if n not in self._known and not n.startswith(_FOREIGN)]
        return [unknown_parameter(name, self._known) for name in foreign]

    def unmatched_overrides(self) -> list[str]:
        """One line for each QoS override that was given and fits no input; asked when the inputs are there."""
        declared = [f"qos_overrides.{name}" for name in self._node.get_parameters_by_prefix("qos_overrides")]
        given = getattr(self._node, "_parameter_overrides", {})
        return unmatched_overrides(given, declared, self._node.resolve_topic_name)

    def differences(self) -> str:
        """One line on what was given and is not the preset's, or the node's, own value; empty if nothing."""
        now = {**values_of(self.config), **dataclasses.asdict(self.settings)}
        told = {name: now[name] for name in self._defaults if name in self._given and name != "mode"}
        return differences(self.preset_name, told, self._defaults)

    def _declare(self, info: FieldInfo) -> Any:
        """Declare one parameter and return its value: the default, or what the user gave."""
        default = list(info.default) if isinstance(info.default, tuple) else info.default
        try:
            descriptor = parameter_descriptor(info, info.name in _READ_ONLY)
            return self._node.declare_parameter(info.name, default, descriptor).value
        except InvalidParameterTypeException as error:
            raise ConfigError(type_text(info, error)) from None
        except InvalidParameterValueException as error:
            raise ConfigError(f"parameter {info.name}: {error}") from None

    def _changed(self, parameters: list[Parameter]) -> tuple[Config, NodeSettings]:
        values = {p.name: p.value for p in parameters if p.name in self._known}
        own = {info.name for info in OWN}
        config = with_values(self.config, {name: v for name, v in values.items() if name not in own})
        return config, _settings(self.settings, {name: v for name, v in values.items() if name in own})

    def _check_change(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            load_descriptors(self._changed(parameters)[0])
        except (ConfigError, MissingDependencyError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_change(self, parameters: list[Parameter]) -> None:
        self._given |= {parameter.name for parameter in parameters}
        self.config, self.settings = self._changed(parameters)


def _settings(base: NodeSettings, values: dict[str, Any]) -> NodeSettings:
    plain: dict[str, Any] = {name: tuple(v) if name == "sensor_origin" else v for name, v in values.items()}
    return dataclasses.replace(base, **plain)
