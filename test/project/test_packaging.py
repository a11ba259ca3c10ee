"""What setup.py, package.xml, the pins and the set-up scripts promise, held against the source and tried out."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import setuptools
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pages import PAGES
from places import NOT_COPIED, PROJECT_ROOT
from test_architecture import ROS_MODULES, imported_names

import svc_ros

MINORS = ("3.10", "3.11", "3.12", "3.13")
DISTRIBUTIONS = {
    "yaml": {"pyyaml"},
    "open3d": {"open3d", "open3d-cpu"},
    "mpl_toolkits": {"matplotlib"},
    "backports": {"backports-zstd"},
    "compression": {"backports-zstd"},  # Python's own from 3.14 on
}
ROS_PACKAGES = {"tf2_ros": "tf2_ros_py"}
SCRIPTS = {"svc_ros", "registration_node", "bag_player"}


@pytest.fixture(scope="module")
def arguments() -> dict[str, Any]:
    """What setup.py hands to setuptools."""
    given: dict[str, Any] = {}
    original, folder = setuptools.setup, Path.cwd()
    setuptools.setup = given.update  # type: ignore[assignment]
    try:
        os.chdir(PROJECT_ROOT)
        exec(compile(Path("setup.py").read_text(), "setup.py", "exec"), {"__file__": "setup.py", "__name__": "setup"})
    finally:
        setuptools.setup = original
        os.chdir(folder)
    return given


@pytest.fixture(scope="module")
def manifest() -> ElementTree.Element:
    return ElementTree.parse(PROJECT_ROOT / "package.xml").getroot()


def texts(manifest: ElementTree.Element, tag: str) -> set[str]:
    return {element.text or "" for element in manifest.iter(tag)}


def third_party_imports() -> Iterator[tuple[str, str]]:
    """(top-level module, where) of everything that is neither this package nor of Python itself."""
    for path in sorted([*PROJECT_ROOT.glob("svc_ros/**/*.py"), *PROJECT_ROOT.glob("launch/*.py")]):
        package = ".".join(path.relative_to(PROJECT_ROOT).parent.parts)
        for name, line in imported_names(ast.parse(path.read_text(encoding="utf-8")), package):
            top = name.split(".")[0]
            if top != "svc_ros" and top not in sys.stdlib_module_names:
                yield top, f"{path.relative_to(PROJECT_ROOT)}:{line}"


def requirements(arguments: dict[str, Any], extras: bool = True) -> list[Requirement]:
    lines = list(arguments["install_requires"])
    if extras:
        lines += [line for extra in arguments["extras_require"].values() for line in extra]
    return [Requirement(line) for line in lines]


def run(*command: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    given = {"capture_output": True, "text": True, "timeout": 300, "stdin": subprocess.DEVNULL, **options}
    return subprocess.run([str(part) for part in command], check=False, **given)


class TestDeclarations:
    def test_every_import_is_declared_in_setup_py(self, arguments: dict[str, Any]) -> None:
        declared = {canonicalize_name(requirement.name) for requirement in requirements(arguments)}
        missing = [
            f"{where}: {module}"
            for module, where in third_party_imports()
            if not ROS_MODULES.match(module)
            and declared.isdisjoint(DISTRIBUTIONS.get(module, {canonicalize_name(module)}))
        ]
        assert missing == []

    def test_every_ros_import_is_declared_in_package_xml(self, manifest: ElementTree.Element) -> None:
        optional = {"rtabmap_msgs", "pose_graph_tools_msgs"}  # imported only where `edges` asks for them
        assert all(name in (PROJECT_ROOT / "package.xml").read_text() for name in optional)
        declared = {*texts(manifest, "exec_depend"), *optional}
        missing = [
            f"{where}: {module}"
            for module, where in third_party_imports()
            if ROS_MODULES.match(module) and ROS_PACKAGES.get(module, module) not in declared
        ]
        assert missing == []

    def test_required_packages_are_in_package_xml_or_named_in_its_comment(self, arguments: dict[str, Any]) -> None:
        text = (PROJECT_ROOT / "package.xml").read_text()
        names = {canonicalize_name(requirement.name) for requirement in requirements(arguments, extras=False)}
        keys = {"open3d-cpu": "python3-open3d-pip", "pyyaml": "python3-yaml"}
        assert [name for name in names if keys.get(name, name) not in text] == []

    def test_one_version(self, arguments: dict[str, Any], manifest: ElementTree.Element) -> None:
        assert arguments["version"] == svc_ros.__version__ == (manifest.findtext("version") or "")
        newest = re.search(r"^(\d+\.\d+\.\d+) \(", (PROJECT_ROOT / "CHANGELOG.rst").read_text(), re.MULTILINE)
        assert newest is not None
        assert newest.group(1) == svc_ros.__version__

    def test_manifest_is_of_format_3_and_valid(self, manifest: ElementTree.Element) -> None:
        assert manifest.get("format") == "3"
        assert manifest.findtext("export/build_type") == "ament_python"
        package = pytest.importorskip("catkin_pkg.package", reason="catkin_pkg not installed")
        parsed = package.parse_package(str(PROJECT_ROOT))  # raises for whatever colcon would refuse
        assert (parsed.name, parsed.licenses) == ("svc_ros", ["Apache-2.0"])

    def test_shared_files_are_complete(self, arguments: dict[str, Any]) -> None:
        installed = {name: folder for folder, names in arguments["data_files"] for name in names}
        assert installed["resource/svc_ros"] == "share/ament_index/resource_index/packages"
        assert installed["package.xml"] == "share/svc_ros"
        for folder, pattern in (("launch", "*.py"), ("config", "*.yaml"), ("config", "*.rviz"), ("config", "*.json")):
            files = {f"{folder}/{path.name}" for path in (PROJECT_ROOT / folder).glob(pattern)}
            assert files, f"{folder}/ is empty"
            assert files <= {name for name, place in installed.items() if place == f"share/svc_ros/{folder}"}

    def test_every_subpackage_is_packaged(self, arguments: dict[str, Any]) -> None:
        folders = {path.parent for path in PROJECT_ROOT.glob("svc_ros/**/*.py")}
        assert set(arguments["packages"]) == {".".join(f.relative_to(PROJECT_ROOT).parts) for f in folders}

    def test_entry_points_exist(self, arguments: dict[str, Any]) -> None:
        points = dict(line.split(" = ") for line in arguments["entry_points"]["console_scripts"])
        assert set(points) == SCRIPTS
        for target in points.values():
            module, function = target.split(":")
            tree = ast.parse((PROJECT_ROOT / (module.replace(".", "/") + ".py")).read_text())
            assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, target

    @pytest.mark.parametrize("minor", MINORS)
    def test_pins_satisfy_what_setup_py_asks_for(self, arguments: dict[str, Any], minor: str) -> None:
        lines = (PROJECT_ROOT / f"constraints/py{minor}.txt").read_text().splitlines()
        pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
        machine = {"python_version": minor, "platform_system": "Linux", "platform_machine": "x86_64"}
        if minor == "3.10":  # where `make setup` leaves it out: its wheels need numpy 1
            arguments = {**arguments, "extras_require": {**arguments["extras_require"], "graph": []}}
        for requirement in requirements(arguments):
            if requirement.marker is None or requirement.marker.evaluate({**machine, "extra": ""}):
                version = pins[canonicalize_name(requirement.name)]
                assert requirement.specifier.contains(version), f"{requirement} but {version}"


class TestInstallation:
    """pip must make the scripts of a venv although setup.cfg sends colcon's to lib/svc_ros."""

    @pytest.mark.parametrize("editable", [pytest.param(True, marks=pytest.mark.slow), False])
    def test_pip_makes_the_scripts(self, tmp_path: Path, editable: bool) -> None:
        source = tmp_path / "source"
        shutil.copytree(PROJECT_ROOT, source, ignore=NOT_COPIED)
        prefix = tmp_path / "prefix"
        flags = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--ignore-installed"]
        what = ["-e", source] if editable else [source]
        done = run(sys.executable, "-m", "pip", "install", *flags, "--prefix", prefix, *what)
        assert done.returncode == 0, done.stderr[-2000:]
        assert {path.name for path in (prefix / "bin").iterdir()} >= SCRIPTS
        if not editable:
            share = prefix / "share"
            assert (share / "ament_index/resource_index/packages/svc_ros").is_file()
            assert (share / "svc_ros/package.xml").is_file()
            assert {path.name for path in (share / "svc_ros/config").glob("*.yaml")} >= {"lidar_outdoor.yaml"}
            assert any((prefix / "lib").glob("python3*/site-packages/svc_ros/py.typed"))
            installed = {path.name for path in (prefix / "lib").glob("python3*/site-packages/*")}
            assert installed == {"svc_ros", f"svc_ros-{svc_ros.__version__}.dist-info"}  # no tests, no example package
            (shell,) = (prefix / "lib").glob("python3*/site-packages/svc_ros/report/page")
            source_of_it = PROJECT_ROOT / "svc_ros/report/page"
            assert {path.name for path in shell.iterdir()} == {path.name for path in source_of_it.iterdir()}

    @pytest.mark.slow
    def test_colcon_builds_and_tests_the_package(self, tmp_path: Path) -> None:
        pytest.importorskip("colcon_core", reason="colcon not installed: pip install 'svc_ros[test]'")
        pytest.importorskip("colcon_ros", reason="colcon-ros not installed: pip install 'svc_ros[test]'")
        shutil.copytree(PROJECT_ROOT, tmp_path / "src" / "svc_ros", ignore=NOT_COPIED)
        environment = {**os.environ, "COLCON_HOME": str(tmp_path / "home"), "PYTHONWARNINGS": "ignore"}
        colcon = (sys.executable, "-m", "colcon")
        built = run(*colcon, "build", cwd=tmp_path, env=environment)
        assert built.returncode == 0, built.stdout + built.stderr
        prefix = tmp_path / "install" / "svc_ros"
        assert {path.name for path in (prefix / "lib" / "svc_ros").iterdir()} >= SCRIPTS
        assert (prefix / "share/ament_index/resource_index/packages/svc_ros").is_file()
        assert (prefix / "share/svc_ros/package.xml").is_file()
        assert any((prefix / "share/svc_ros/launch").glob("*.launch.py"))
        assert (prefix / "share/svc_ros/config/lidar_outdoor.yaml").is_file()
        tested = run(*colcon, "test", "--pytest-args", "test/pipeline/test_pairing.py", cwd=tmp_path, env=environment)
        assert tested.returncode == 0, tested.stdout + tested.stderr
        result = run(*colcon, "test-result", "--all", cwd=tmp_path, env=environment)
        summary = re.search(r"(\d+) tests?, (\d+) errors?, (\d+) failures?", result.stdout)
        assert summary is not None, result.stdout + result.stderr
        num_tests, num_errors, num_failures = map(int, summary.groups())
        assert num_tests > 0
        assert (num_errors, num_failures) == (0, 0), result.stdout

    def test_documented_colcon_commands_are_known_to_what_the_set_up_installs(self) -> None:
        pytest.importorskip("colcon_core", reason="colcon not installed: pip install 'svc_ros[test]'")
        pytest.importorskip("colcon_ros", reason="colcon-ros not installed: pip install 'svc_ros[test]'")
        commands = {c for text in PAGES.values() for c in re.findall(r"^ *python -m colcon (.*)", text, re.MULTILINE)}
        assert commands
        parts = [part.split() for c in commands for part in c.replace("python -m colcon ", "").split("&&")]
        for verb, *words in parts:
            known = run(sys.executable, "-m", "colcon", verb, "--help").stdout
            options = {word for word in words if word.startswith("--")}
            assert options <= set(re.findall(r"--[\w-]+", known)), verb


def stub(folder: Path, name: str, body: str) -> Path:
    """An executable of our own on the search path."""
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def environment_with(folder: Path, **more: str) -> dict[str, str]:
    return {"PATH": f"{folder}:/usr/bin:/bin", "HOME": str(folder), **more}


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash not found")
class TestSetupScripts:
    FIND = PROJECT_ROOT / "tools" / "find_python.sh"
    LIBRARIES = PROJECT_ROOT / "tools" / "system_libraries.sh"
    CHROMIUM = PROJECT_ROOT / "tools" / "chromium.sh"

    def test_a_shim_that_does_not_run_is_passed_over(self, tmp_path: Path) -> None:
        shim = stub(tmp_path / "bin", "python3.12", "echo 'command not found' >&2; exit 127")
        stub(tmp_path / "bin", "pyenv", "exit 1")
        stub(tmp_path / "bin", "python3.13", "echo /opt/python3.13")
        done = run(self.FIND, env=environment_with(tmp_path / "bin"))
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip() not in ("", str(shim))

    def test_pythons_of_pyenv_are_found(self, tmp_path: Path) -> None:
        home = tmp_path / "pyenv" / "versions" / "3.12.7" / "bin"
        home.mkdir(parents=True)
        stub(home, "python", "echo /opt/python-of-pyenv")
        for name in ("python3.12", "python3.13", "python3.11", "python3.10", "python3"):
            stub(tmp_path / "bin", name, "exit 127")
        stub(tmp_path / "bin", "pyenv", f"echo {tmp_path / 'pyenv'}")
        found = run(self.FIND, env=environment_with(tmp_path / "bin")).stdout.strip()
        assert found == "/opt/python-of-pyenv" or found.startswith(("/usr/bin/python3.12", "/usr/local/bin/python3.12"))

    def test_the_named_python_or_none(self, tmp_path: Path) -> None:
        named = run(self.FIND, env=environment_with(tmp_path, PYTHON=sys.executable))
        assert named.stdout.strip() == sys.executable
        refused = run(self.FIND, env=environment_with(tmp_path, PYTHON="/bin/false"))
        assert refused.returncode == 1
        assert "/bin/false" in refused.stderr
        assert "python3-venv" in refused.stderr

    def broken_python(self, folder: Path) -> Path:
        """Cannot import open3d until apt-get (a stub as well) has run."""
        stub(folder, "apt-get", f'echo "$*" >>{folder}/asked; case $* in *install*) touch {folder}/repaired;; esac')
        missing = "OSError: libGL.so.1: cannot open shared object file: No such file or directory"
        return stub(folder, "python", f"test -e {folder}/repaired || {{ echo '{missing}' >&2; exit 1; }}")

    def test_libraries_are_installed_only_if_open3d_needs_them(self, tmp_path: Path) -> None:
        python = self.broken_python(tmp_path / "bin")
        stub(tmp_path / "bin", "id", "echo 0")
        environment = environment_with(tmp_path / "bin")
        assert run(self.LIBRARIES, python, env=environment).returncode == 0
        asked = (tmp_path / "bin" / "asked").read_text()
        assert all(name in asked for name in ("libusb-1.0-0", "libgl1", "libegl1", "libgomp1", "libx11-6"))
        assert run(self.LIBRARIES, python, env=environment).returncode == 0
        assert (tmp_path / "bin" / "asked").read_text() == asked

    def test_without_the_right_to_install_the_command_is_printed(self, tmp_path: Path) -> None:
        python = self.broken_python(tmp_path / "bin")
        stub(tmp_path / "bin", "id", "echo 1000")
        stub(tmp_path / "bin", "sudo", "exit 1")
        done = run(self.LIBRARIES, python, env=environment_with(tmp_path / "bin"))
        assert done.returncode == 1
        assert "libGL.so.1" in done.stderr
        assert "sudo apt-get install -y libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6" in done.stderr
        assert not (tmp_path / "bin" / "asked").exists()

    def test_another_import_error_is_shown_and_nothing_installed(self, tmp_path: Path) -> None:
        python = stub(tmp_path / "bin", "python", "echo 'ImportError: numpy is too old' >&2; exit 1")
        stub(tmp_path / "bin", "apt-get", f"touch {tmp_path}/asked")
        done = run(self.LIBRARIES, python, env=environment_with(tmp_path / "bin"))
        assert done.returncode == 1
        assert "numpy is too old" in done.stderr
        assert not (tmp_path / "asked").exists()

    def machine_without_browser(self, folder: Path, apt_get: str, user: int = 0) -> dict[str, str]:
        """A search path with nothing on it but a shell and these stubs."""
        stub(folder, "apt-get", f'echo "$*" >>{folder}/asked\n{apt_get}')
        stub(folder, "id", f"echo {user}")
        stub(folder, "sudo", "exit 1")
        for name in ("bash", "sh"):
            (folder / name).symlink_to(shutil.which(name) or f"/bin/{name}")
        return {"PATH": str(folder), "HOME": str(folder)}

    def test_chromium_is_installed_only_where_there_is_none(self, tmp_path: Path) -> None:
        environment = self.machine_without_browser(tmp_path / "bin", "exit 0")
        shell = shutil.which("bash") or "/bin/bash"
        done = run(shell, self.CHROMIUM, env=environment)
        assert (done.returncode, "skipped" in done.stdout) == (0, False)
        asked = (tmp_path / "bin" / "asked").read_text()
        assert asked.strip().endswith("install -q -y --no-install-recommends chromium")
        stub(tmp_path / "bin", "chromium", "exit 0")
        assert run(shell, self.CHROMIUM, env=environment).stdout == ""
        assert (tmp_path / "bin" / "asked").read_text() == asked

    @pytest.mark.parametrize(("apt_get", "user"), [("exit 100", 0), ("exit 0", 1000)])
    def test_the_set_up_goes_on_without_chromium_and_says_what_is_lost(
        self, tmp_path: Path, apt_get: str, user: int
    ) -> None:
        environment = self.machine_without_browser(tmp_path / "bin", apt_get, user)
        done = run(shutil.which("bash") or "/bin/bash", self.CHROMIUM, env=environment)
        assert done.returncode == 0
        assert "the tests of report.html in a browser will be skipped" in done.stdout
        assert "sudo apt-get install -y --no-install-recommends chromium" in done.stdout
        assert (tmp_path / "bin" / "asked").exists() == (user == 0)

    @pytest.mark.parametrize("script", ["tools/setup.sh", "tools/chromium.sh", "tools/lock.sh", ".ci/run"])
    def test_scripts_are_executable_and_parse(self, script: str) -> None:
        path = PROJECT_ROOT / script
        if not path.exists():
            pytest.skip(f"{script} is not part of this copy")
        assert os.access(path, os.X_OK)
        assert run("bash", "-n", path).returncode == 0

    @pytest.mark.skipif(shutil.which("make") is None, reason="make not found")
    def test_help_tells_every_target(self) -> None:
        told = run("make", "--no-print-directory", "help", cwd=PROJECT_ROOT).stdout
        for target in ("setup", "lint", "type", "test", "demo", "bench", "clean"):
            assert f"make {target} " in told
