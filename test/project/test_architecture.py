"""The house rules, read off the source: which layer sees which, who may print, and how large things may get."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from places import PROJECT_ROOT

PACKAGE = PROJECT_ROOT / "svc_ros"
FILES = sorted(PACKAGE.rglob("*.py"))

_BELOW = {"core", "io"}
_BESIDE = {"pipeline", "report", "simulation"}  # three that know nothing of each other
SEES = {  # layer -> layers that it may import
    "core": {"core"},
    "io": _BELOW,
    "pipeline": _BELOW | {"pipeline"},
    "report": _BELOW | {"report"},
    "simulation": _BELOW | {"simulation"},
    "evaluation": _BELOW | _BESIDE | {"evaluation"},
    "replay": _BELOW | _BESIDE | {"evaluation", "replay"},
    "ros": _BELOW | _BESIDE | {"evaluation", "replay", "ros"},
    "cli": _BELOW | _BESIDE | {"evaluation", "replay", "cli"},
    "__init__": {"core"},
    "__main__": {"cli"},
}
WITHOUT_ROS = [layer for layer in SEES if layer not in ("ros", "__init__", "__main__")]
ROS_MODULES = re.compile(
    r"^(rclpy|rcl_interfaces|builtin_interfaces|launch(_ros|_testing)?|ament_index_python|message_filters"
    r"|diagnostic_updater|rosbag2_py|tf2_\w+|\w+_msgs|\w+_srvs|sensor_msgs_py)$"
)
MAX_FILE_LINES, MAX_BODY_LINES, MAX_CLI_BODY_LINES, MAX_FILES = 300, 50, 80, 20
TEXT_SUFFIXES = {".py", ".sh", ".md", ".rst", ".yaml", ".yml", ".toml", ".cfg", ".xml", ".txt", ".json", ".rviz", ""}
FOREIGN = re.compile(
    r"(?<![\w.-])/(?:work|root)/"
    r"|pypi\.org|pythonhosted|registry\.npmjs|deb\.debian|packages\.ros\.org|archive\.ubuntu"
)


def label(path: Path) -> str:
    return str(path.relative_to(PROJECT_ROOT))


def layer_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else path.stem


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def imported_names(tree: ast.AST, package: str = "") -> Iterator[tuple[str, int]]:
    """Dotted names of all imports, wherever they stand, with their lines; `package` resolves relative ones."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((f"{module}.{alias.name}", node.lineno) for alias in node.names)
        elif isinstance(node, ast.Call) and called(node).endswith("import_module") and node.args:
            first = node.args[0]
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                yield first.value, node.lineno


def imports_of(path: Path) -> Iterator[tuple[str, int]]:
    yield from imported_names(parsed(path), ".".join(path.relative_to(PROJECT_ROOT).parent.parts))


def called(node: ast.Call) -> str:
    return ast.unparse(node.func)


def calls_of(path: Path) -> Iterator[tuple[str, int]]:
    return ((called(node), node.lineno) for node in ast.walk(parsed(path)) if isinstance(node, ast.Call))


def forbidden_layers(path: Path) -> list[str]:
    layer, wrong = layer_of(path), []
    for name, line in imports_of(path):
        parts = name.split(".")
        if parts[0] == "svc_ros" and len(parts) > 1 and parts[1] in SEES and parts[1] not in SEES[layer]:
            wrong.append(f"{label(path)}:{line} imports {name}")
    return wrong


def test_every_layer_has_its_rule() -> None:
    assert {layer_of(path) for path in FILES} - {"__init__", "__main__"} == set(SEES) - {"__init__", "__main__"}


@pytest.mark.parametrize("layer", sorted(SEES))
def test_imports_point_one_way(layer: str) -> None:
    wrong = [line for path in FILES if layer_of(path) == layer for line in forbidden_layers(path)]
    assert wrong == []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import svc_ros.cli.main", ["svc_ros.cli.main"]),
        ("def f():\n    from ..cli import main", ["svc_ros.cli.main"]),
        ("from . import x", ["svc_ros.ros.x"]),
        ("from svc_ros import cli", ["svc_ros.cli"]),
        ("import importlib\nimportlib.import_module('svc_ros.cli')", ["importlib", "svc_ros.cli"]),
    ],
)
def test_no_form_of_import_is_overlooked(source: str, found: list[str]) -> None:
    assert [name for name, _ in imported_names(ast.parse(source), "svc_ros.ros")] == found


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Counted is every import: those in functions, too, and those for type checkers."""
    known = {module_name(path): path for path in FILES}
    homes = {name: {home_of(found, known) for found, _ in imports_of(path)} for name, path in known.items()}
    assert circles_of({name: found - {"", name} for name, found in homes.items()}) == []


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(PROJECT_ROOT).with_suffix("").parts).removesuffix(".__init__")


def home_of(name: str, known: Mapping[str, Path]) -> str:
    """The module that a dotted name is of, '' if it is none of ours."""
    while name and name not in known:
        name = name.rpartition(".")[0]
    return name


def circles_of(imports: Mapping[str, set[str]]) -> list[str]:
    """What is left without modules that import nothing of it, and without those that nothing of it imports."""
    left = {name: set(found) for name, found in imports.items()}
    while ends := [name for name, found in left.items() if not found & set(left)]:
        left = {name: found for name, found in left.items() if name not in ends}
    while starts := set(left) - {found for name in left for found in left[name]}:
        left = {name: found for name, found in left.items() if name not in starts}
    return [f"{name} imports {', '.join(sorted(found & set(left)))}" for name, found in sorted(left.items())]


@pytest.mark.parametrize(
    ("imports", "found"),
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"a", "c"}, "c": set(), "d": {"a"}}, ["a imports b", "b imports a"]),
        ({"a": {"b"}, "b": {"c"}, "c": {"a"}}, ["a imports b", "b imports c", "c imports a"]),
    ],
)
def test_no_circle_is_overlooked(imports: dict[str, set[str]], found: list[str]) -> None:
    assert circles_of(imports) == found


def test_only_the_ros_layer_imports_ros() -> None:
    wrong = [
        f"{label(path)}:{line} imports {name}"
        for path in FILES
        if layer_of(path) != "ros"
        for name, line in imports_of(path)
        if ROS_MODULES.match(name.split(".")[0])
    ]
    assert wrong == []


def test_all_other_layers_load_without_ros() -> None:
    """Every module, in a Python where importing rclpy or a message package fails."""
    modules = [module_name(path) for path in FILES if layer_of(path) in WITHOUT_ROS]
    blocked = ["rclpy", "rcl_interfaces", "builtin_interfaces", "sensor_msgs", "geometry_msgs", "std_msgs",
               "std_srvs", "nav_msgs", "diagnostic_msgs", "visualization_msgs", "tf2_ros", "tf2_msgs"]  # fmt: skip
    code = (
        "import importlib, sys\n"
        f"sys.modules.update(dict.fromkeys({blocked!r}))\n"
        f"for name in {modules!r}:\n    importlib.import_module(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=PROJECT_ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]


def test_the_library_never_prints_exits_or_configures_logging() -> None:
    """The command line may, and so may programs of the ROS layer: modules that a person starts."""
    banned = {"print", "exit", "quit", "sys.exit", "os._exit", "logging.basicConfig", "warnings.simplefilter"}
    wrong = [
        f"{label(path)}:{line} calls {name}"
        for path in FILES
        if layer_of(path) not in ("cli", "__main__") and not is_program(path)
        for name, line in calls_of(path)
        if name in banned
    ]
    assert wrong == []


def is_program(path: Path) -> bool:
    functions = (node.name for node in parsed(path).body if isinstance(node, ast.FunctionDef))
    return layer_of(path) == "ros" and "main" in functions


def test_no_exception_is_caught_blindly() -> None:
    wrong = [
        f"{label(path)}:{node.lineno}"
        for path in FILES
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.ExceptHandler) and (node.type is None or swallows_everything(node))
    ]
    assert wrong == []


def swallows_everything(handler: ast.ExceptHandler) -> bool:
    """`except Exception: pass` hides what went wrong; a handler that does something with it may be broad."""
    broad = isinstance(handler.type, ast.Name) and handler.type.id in ("Exception", "BaseException")
    return broad and all(isinstance(statement, ast.Pass | ast.Continue) for statement in handler.body)


def test_files_stay_readable() -> None:
    sizes = {label(path): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert {name: lines for name, lines in sizes.items() if lines > MAX_FILE_LINES} == {}


def test_folders_stay_readable() -> None:
    sizes = Counter(label(path.parent) for path in FILES)
    assert {folder: num for folder, num in sizes.items() if num > MAX_FILES} == {}


def test_functions_stay_readable() -> None:
    too_long = []
    for path in FILES:
        limit = MAX_CLI_BODY_LINES if layer_of(path) == "cli" else MAX_BODY_LINES
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and body_lines(node) > limit:
                too_long.append(f"{label(path)}:{node.lineno} {node.name}: {body_lines(node)} lines")
    assert too_long == []


def body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of the statements after the docstring."""
    documented = ast.get_docstring(function) is not None
    statements = function.body[1:] if documented else function.body
    return (function.end_lineno or 0) - statements[0].lineno + 1 if statements else 0


def project_texts() -> Iterator[Path]:
    """What a reader of the project sees; build products and environments are not part of it."""
    skipped = {".git", ".venv", "out", "build", "install", "log", "dist", "__pycache__", ".hypothesis"}
    for folder, folders, names in os.walk(PROJECT_ROOT):
        folders[:] = sorted(f for f in folders if f not in skipped and not f.endswith(("_cache", ".egg-info")))
        texts = (Path(folder, name) for name in sorted(names) if Path(name).suffix in TEXT_SUFFIXES)
        yield from (path for path in texts if path != Path(__file__).resolve())


def test_no_machine_of_ours_and_no_host_is_named() -> None:
    wrong = [
        f"{label(path)}:{number}: {line.strip()[:80]}"
        for path in project_texts()
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if FOREIGN.search(line)
    ]
    assert wrong == []
