"""Starting without what ROS brings: the launch file without `launch`, the node without rclpy."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys

import pytest
from conftest import PROJECT_ROOT

from svc_ros.core.config import METHODS, PRESETS

LAUNCH_FILE = PROJECT_ROOT / "launch" / "registration.launch.py"


@pytest.fixture(scope="module")
def tree():
    return ast.parse(LAUNCH_FILE.read_text("utf-8"), str(LAUNCH_FILE))


@pytest.fixture(scope="module")
def arguments(tree):
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id == "ARGUMENTS":
            return ast.literal_eval(statement.value)
    raise AssertionError("ARGUMENTS not found")


def test_file_compiles_and_has_its_entry_point(tree):
    compile(tree, str(LAUNCH_FILE), "exec")
    assert "generate_launch_description" in {f.name for f in tree.body if isinstance(f, ast.FunctionDef)}


def test_every_argument_is_described(arguments):
    assert {"preset", "method", "params_file", "source", "target", "namespace", "use_sim_time"} == set(arguments)
    assert all(isinstance(default, str) and text for default, text in arguments.values())


def test_defaults_and_descriptions_name_what_exists(arguments):
    assert arguments["preset"][0] in PRESETS
    assert arguments["method"][0] in METHODS
    assert all(name in arguments["preset"][1] for name in PRESETS)
    assert all(name in arguments["method"][1] for name in METHODS)


def test_names_are_those_of_the_node(tree):
    node = (PROJECT_ROOT / "svc_ros" / "ros" / "registration_node.py").read_text("utf-8")
    texts = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    assert {"svc_ros", "registration_node", "svc_registration", "source_points", "target_points"} <= texts
    assert 'NODE_NAME = "svc_registration"' in node
    inputs = (PROJECT_ROOT / "svc_ros" / "ros" / "inputs.py").read_text("utf-8")
    assert '_points"' in inputs


def test_file_describes_a_launch_where_launch_is_installed(arguments):
    pytest.importorskip("launch_ros", reason="needs launch_ros (apt install ros-jazzy-launch-ros)")
    spec = importlib.util.spec_from_file_location("registration_launch", LAUNCH_FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    description = module.generate_launch_description()
    assert len(description.entities) == len(arguments) + 2


def test_missing_rclpy_is_one_line_and_exit_code_2():
    code = "import sys; sys.modules['rclpy'] = None; from svc_ros.ros.node import main; sys.exit(main([]))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert run.returncode == 2
    (line,) = run.stderr.splitlines()
    assert "svc_ros[ros]" in line
    assert "ros-jazzy-rclpy" in line
