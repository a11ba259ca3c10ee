"""The checks behind `svc_ros doctor`: values only, the command renders them.

Nothing here imports ROS: whether rclpy works is asked of a Python of its own, because a wrong mix of ROS builds can
take the process with it.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.metadata as metadata
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from svc_ros.cli.doctor.bag import check_bag
from svc_ros.cli.doctor.finding import Finding, Level
from svc_ros.core.config import PRESETS
from svc_ros.core.errors import MissingDependencyError, SvcError
from svc_ros.io.config_yaml import config_folder, read_config
from svc_ros.pipeline.graph_optimisation import load_gtsam

__all__ = ["Finding", "Level", "check_bag", "check_installation"]

_REQUIRED = {  # module -> how to install it
    "numpy": "pip install numpy",
    "scipy": "pip install scipy",
    "numba": "pip install numba",
    "open3d": "pip install open3d-cpu (x86-64 Linux) or pip install open3d",
    "kiss_icp": "pip install kiss-icp",
    "small_gicp": "pip install small-gicp",
    "rosbags": "pip install 'rosbags>=0.11'",
    "yaml": "pip install pyyaml",
    "matplotlib": "pip install matplotlib",
}
_OPTIONAL = {  # module -> what it is for, how to install it
    "laspy": ("LAS and LAZ scans", "pip install 'laspy[lazrs]'"),
    "pye57": ("E57 scans", "pip install pye57"),
    "plotly": ("HTML reports", "pip install plotly"),
    "evo": ("errors of trajectories: replay --reference", "pip install 'evo>=1.30'"),
    "gtsam": ("optimised pose graphs", "pip install 'svc_ros[graph]'"),
    "kiss_matcher": ("comparisons", "pip install kiss-matcher"),
}
_DISTRIBUTIONS = {"open3d": ("open3d", "open3d-cpu"), "yaml": ("pyyaml",)}
_OPEN3D_LIBRARIES = {  # what Open3D's wheel loads of the system -> Debian's package
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
}
_BOOTSTRAP_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_WHEEL_ADVICE = "without a ROS: pip install 'svc_ros[ros]'; with one: source its setup file first"


def check_installation(preset_folder: Path | None = None) -> list[Finding]:
    """Look at Python, the packages, Open3D's system libraries, rclpy and the preset files.

    preset_folder: where the YAML presets lie, if not where the package was installed or checked out.
    """
    required = [_check_required(module, advice) for module, advice in _REQUIRED.items()]
    optional = [_check_optional(module, *about) for module, about in _OPTIONAL.items()]
    open3d_works = all(finding.level == "ok" for finding in required if finding.name == "open3d")
    return [
        _check_python(),
        *required,
        *check_system_libraries(open3d_works),
        *check_ros(sys.path),
        *optional,
        *check_presets(preset_folder or config_folder()),
    ]


def check_system_libraries(open3d_works: bool) -> list[Finding]:
    """Try to load every library that Open3D's wheel expects of a Linux system; one finding for each missing one."""
    if platform.system() != "Linux":
        return []
    missing = [library for library in _OPEN3D_LIBRARIES if not _loads(library)]
    if not missing:
        return [Finding("system libraries", "ok", f"all {len(_OPEN3D_LIBRARIES)} that Open3D loads")]
    level: Level = "warn" if open3d_works else "error"
    return [
        Finding(library, level, "missing, Open3D loads it", f"apt-get install {_OPEN3D_LIBRARIES[library]}")
        for library in missing
    ]


def check_ros(search_path: Sequence[str]) -> list[Finding]:
    """Say where rclpy comes from and whether it works; two of them at once are an error."""
    homes = _rclpy_homes(search_path)
    if not homes:
        return [Finding("rclpy", "warn", "not found: everything but the node works", _WHEEL_ADVICE)]
    if len(homes) > 1 or (_from_wheels(homes[0]) and (sourced := _sourced_ros())):
        places = ", ".join(str(home) for home in homes) if len(homes) > 1 else f"{homes[0]} and the sourced {sourced}"
        advice = "keep one: a new terminal without the ROS, or an environment without the wheels (make setup makes it)"
        return [Finding("rclpy", "error", f"two builds at once: {places}", advice)]
    origin = "wheels" if _from_wheels(homes[0]) else f"ROS {os.environ.get('ROS_DISTRO', 'of the system')}"
    problem = _import_problem("rclpy")
    if problem:
        return [Finding("rclpy", "error", f"from {origin}, cannot be imported: {problem}", _ros_import_advice())]
    return [Finding("rclpy", "ok", f"from {origin} ({homes[0]})"), *_check_numpy_of_ros(_from_wheels(homes[0]))]


def check_presets(folder: Path) -> list[Finding]:
    """Read the YAML file of every preset."""
    return [_check_preset(name, folder / f"{name}.yaml") for name in PRESETS]


def _check_preset(name: str, path: Path) -> Finding:
    if not path.is_file():
        return Finding(f"preset {name}", "warn", f"no file {path}", "the built-in values are used; install again")
    try:
        read_config(path, PRESETS[name])
    except SvcError as error:
        return Finding(f"preset {name}", "error", str(error), "mend the file, or print a good one: svc_ros config")
    return Finding(f"preset {name}", "ok", str(path))


def _check_python() -> Finding:
    version = platform.python_version()
    if (3, 10) <= sys.version_info[:2] <= (3, 13):
        return Finding("Python", "ok", f"{version} ({sys.executable})")
    return Finding("Python", "warn", version, "tried with 3.10 to 3.13 only; make setup PYTHON=/path/to/python3.12")


def _check_required(module: str, advice: str) -> Finding:
    problem = _load(module)
    if problem is None:
        return Finding(module, "ok", _version(module))
    library = next((library for library in _OPEN3D_LIBRARIES if library in problem), None)
    if library is not None:
        advice = f"apt-get install {_OPEN3D_LIBRARIES[library]}"
    return Finding(module, "error", problem, advice)


def _check_optional(module: str, use: str, advice: str) -> Finding:
    problem = _load(module)
    if problem is None:
        return Finding(module, "ok", f"{_version(module)} (optional: {use})")
    return Finding(module, "warn", f"{problem} (optional: {use})", advice)


def _load(module: str) -> str | None:
    """Import a module; what went wrong in one line, or None. A broken library is an answer here, whatever it raises."""
    try:
        if module == "gtsam":
            load_gtsam()  # looks first whether its wheel would end the process
        else:
            importlib.import_module(module)
    except ModuleNotFoundError as error:
        return "not installed" if error.name == module else f"cannot be imported: {error}"
    except MissingDependencyError as error:
        return str(error)
    except Exception as error:
        return f"cannot be imported: {' '.join(str(error).split()) or type(error).__name__}"
    return None


def _version(module: str) -> str:
    for name in _DISTRIBUTIONS.get(module, (module.replace("_", "-"),)):
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return "version unknown"


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _rclpy_homes(search_path: Sequence[str]) -> list[Path]:
    """Every different place that `import rclpy` could take it from, in the order of the search path."""
    found = [Path(entry or ".") / "rclpy" for entry in search_path]
    return list(dict.fromkeys(home.resolve() for home in found if (home / "__init__.py").is_file()))


def _from_wheels(home: Path) -> bool:
    return any(home.parent.glob("ros_rclpy-*.dist-info"))


def _sourced_ros() -> str:
    """The prefix of a sourced ROS that has an rclpy of its own, or an empty text."""
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    return next((str(p) for p in prefixes if any(p.glob("lib/python3*/*-packages/rclpy/__init__.py"))), "")


def _import_problem(module: str) -> str:
    """Import in a Python of its own; the last line that it complained with, or an empty text."""
    command = [sys.executable, "-c", f"import {module}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return "no answer within 60 s"
    if done.returncode == 0:
        return ""
    return (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]


def _ros_import_advice() -> str:
    """The wheels mark their children in the environment; a foreign mark keeps them from finding their libraries."""
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    if os.environ.get(_BOOTSTRAP_GUARD) and str(Path(sys.prefix) / "lib") not in libraries:
        return f"unset {_BOOTSTRAP_GUARD}: it was inherited from another environment"
    return _WHEEL_ADVICE


def _check_numpy_of_ros(wheels: bool) -> list[Finding]:
    """Message packages of a Jazzy from apt are built for numpy 1; those of the wheels for the numpy beside them."""
    version = _version("numpy")
    if wheels or version.startswith("1."):
        return []
    return [Finding("numpy beside ROS", "warn", version, "ROS packages from apt expect numpy 1: pip install 'numpy<2'")]
