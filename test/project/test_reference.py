"""docs/reference.md promises names, values, topics, commands and keys: each is held against what there is."""

from __future__ import annotations

import pytest
import yaml
from pages import REFERENCE, absolute, code, node_defaults, rows

from svc_ros.core.config import METHODS, PRESETS, preset, walk
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.io.results import result_to_json


def names(section: str) -> list[str]:
    return [name for row in rows(section) for name in code(row[0])]


def test_the_reasons_are_those_of_the_code_in_its_order():
    assert names("reasons") == [reason.value for reason in Reason]


def test_every_reason_has_a_verdict_a_meaning_and_an_advice():
    verdicts = {verdict.value for verdict in Verdict}
    for reason, verdict, meaning, advice in rows("reasons"):
        assert set(verdict.split(" or ")) <= verdicts, reason
        assert meaning, reason
        assert advice, reason


def test_every_verdict_is_explained():
    for verdict in Verdict:
        assert f"\n| `{verdict.value}` |" in REFERENCE


def test_presets_and_methods_are_complete():
    assert names("presets") == list(PRESETS)
    assert names("methods") == list(METHODS)


def test_parameters_of_the_registration_exist_with_these_values():
    for name, _, *values, _ in rows("parameters of the registration"):
        for preset_name, value in zip(PRESETS, values, strict=True):
            known = {info.name: info.default for info in walk(preset(preset_name))}
            assert yaml.safe_load(value.strip("`")) == known[name.strip("`")], (name, preset_name)


def test_parameters_of_the_node_are_complete_with_their_defaults():
    told = {row[0].strip("`"): row[2].strip("`") for row in rows("parameters of the node")}
    assert told.pop("preset") == "lidar_outdoor"
    assert told == {name: shown(value) for name, value in node_defaults().items()}


def shown(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return str(value).lower() or "empty"


def test_json_keys_are_those_of_a_result():
    keys = result_to_json(RegistrationResult(Verdict.REJECTED, Reason.NO_HYPOTHESIS)).keys()
    assert sorted(names("json keys")) == sorted(keys)


def test_every_mode_has_its_inputs():
    assert [row[0].strip("`") for row in rows("modes")] == ["pair", "scan_matching", "loop_closure", "localization"]
    inputs = {row[0].strip("`") for row in rows("topics") if row[1] == "in"}
    assert inputs <= {name for row in rows("modes") for cell in row[1:3] for name in code(cell)}


@pytest.mark.dds
def test_topics_and_services_are_those_of_the_node(monkeypatch, tmp_path):
    rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
    from map_cases import write_room_map
    from rclpy.context import Context
    from rclpy.parameter import Parameter

    from svc_ros.ros.processes import own_domain_id
    from svc_ros.ros.registration_node import RegistrationNode

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=own_domain_id(7))
    inputs, outputs, services = set(), set(), {}
    try:
        write_room_map(tmp_path / "room")
        for mode in ("pair", "scan_matching", "loop_closure", "localization"):
            folder = str(tmp_path / "room") if mode == "localization" else ""
            values = {"mode": mode, "odometry": "topic", "map_folder": folder}
            given = [Parameter(name, value=value) for name, value in values.items()]
            node = RegistrationNode(
                context=context, parameter_overrides=given, enable_rosout=False, start_parameter_services=False
            )
            inputs |= {described(s, "in") for s in node.subscriptions}
            outputs |= {described(p, "out") for p in node.publishers if p.topic_name != "/parameter_events"}
            services |= {
                absolute(s.srv_name): full_type(s.srv_type)
                for s in node.services
                if "std_srvs" in s.srv_type.__module__
            }
            node.stop(60.0)
            node.destroy_node()
    finally:
        context.try_shutdown()
    told = [(absolute(row[0]), row[1], row[2].strip("`"), row[3]) for row in rows("topics")]
    assert sorted(told) == sorted(inputs | outputs)
    assert {absolute(row[0]): row[1].strip("`") for row in rows("services")} == services


def full_type(kind: type) -> str:
    package, group = kind.__module__.split(".")[:2]
    return f"{package}/{group}/{kind.__name__}"


def described(end, direction: str) -> tuple[str, str, str, str]:
    qos = end.qos_profile
    words = [policy.name.lower().replace("_", " ") for policy in (qos.reliability, qos.durability)]
    return end.topic_name, direction, full_type(end.msg_type), f"{words[0]}, {words[1]}, depth {qos.depth}"
