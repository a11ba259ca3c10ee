"""Whoever waits for kernels to be compiled is told; what is cached is loaded in silence, unless it is stale."""

import os
import subprocess
import sys

import pytest
from places import PROJECT_ROOT

INNER = """
from svc_ros.core.compiling import kernel
STEP = {step}

@kernel()
def inner(x):
    return x + STEP
"""
OUTER = """
from inner import STEP, inner
from svc_ros.core.compiling import kernel

@kernel()
def outer(x):
    return 10 * inner(x)

@kernel()
def constant(x):
    return STEP * x
"""
USE = """
import sys
{first}
from svc_ros.cli.console import working
with working("registering"):
    from outer import constant, outer
    found = outer(1), constant(1)
print(*found)
"""
NOWHERE = "from numba.core.caching import CacheImpl; CacheImpl._locator_classes = []"


@pytest.fixture
def run(tmp_path):
    """Runs a program of three small kernels, two of them in a file that uses the third one's."""
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "outer.py").write_text(OUTER, encoding="utf-8")

    def program(step: int = 1, first: str = "", **more: str) -> subprocess.CompletedProcess[str]:
        (folder / "inner.py").write_text(INNER.format(step=step), encoding="utf-8")
        known = {name: value for name, value in os.environ.items() if name not in ("FORCE_COLOR", "TTY_COMPATIBLE")}
        paths = os.pathsep.join((str(folder), str(PROJECT_ROOT)))
        environment = {**known, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), **more}
        # else a change of one character within a second is none to Python's own cache
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
        code = USE.format(first=first)
        return subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, check=True
        )

    return program


def test_the_first_start_tells_and_the_second_is_silent(run):
    first, second = run(), run()
    assert first.stdout == second.stdout == "20 1\n"
    lines = first.stderr.splitlines()
    assert lines[0].startswith("compiling 3 kernels for this machine, about ")
    assert lines[0].endswith(" s, once")
    assert lines[-1].startswith("compiled 3 kernels in ")
    assert second.stderr == ""


def test_on_a_terminal_a_row_tells(run):
    shown = run(FORCE_COLOR="1", COLUMNS="120")
    assert shown.stdout == "20 1\n"
    assert "compiling 3 kernels for this machine" in shown.stderr
    assert "compiling the kernels, " in shown.stderr
    assert "registering" in shown.stderr


def test_a_kernel_is_stale_where_another_file_changed_that_it_uses(run):
    """Both what it calls and what it reads."""
    assert run(step=1).stdout == "20 1\n"
    changed = run(step=2)
    assert changed.stdout == "30 2\n"
    assert "compiling 3 kernels" in changed.stderr


def test_where_no_cache_can_be_written_that_is_said(run):
    for _ in range(2):
        done = run(first=NOWHERE)
        assert done.stdout == "20 1\n"
        assert "at every start, as no folder can be written to keep them: NUMBA_CACHE_DIR names one" in done.stderr


def test_lines_are_some_seconds_apart():
    from svc_ros.core import compiling

    said = []
    with compiling.told(said.append):
        watch = compiling._kernels.watchers[-1]
        for num in range(101):
            watch(compiling.Compiling(num, 100, True, 0.2 * num, is_busy=num < 100))
    assert said[0] == "compiling 100 kernels for this machine, about 35 s, once"
    assert said[1] == "compiling the kernels: 25 of 100, about 15 s left"
    assert said[-1] == "compiled 100 kernels in 20 s"
    assert len(said) == 6


def test_nobody_is_told_outside_and_nothing_where_nothing_is_compiled():
    from svc_ros.core import compiling

    said = []
    with compiling.told(said.append):
        pass
    assert said == []
    assert compiling._kernels.watchers == []


def test_asking_to_be_told_does_not_load_numba():
    code = "import sys, svc_ros.core.compiling; sys.exit('numba' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=PROJECT_ROOT, check=True, timeout=60)


@pytest.mark.slow
def test_warm_up_leaves_nothing_for_the_first_pair_to_compile(tmp_path):
    code = (
        "from svc_ros.core.compiling import told\n"
        "from svc_ros.core.config import preset\n"
        "from svc_ros.ros.streams.registrar import made_up_scan, warm_up\n"
        "from svc_ros.core.registration import register\n"
        "config = preset('lidar_outdoor')\n"
        "with told(lambda line: print('first', line)):\n    warm_up(config)\n"
        "with told(lambda line: print('then', line)):\n"
        "    register(made_up_scan(config, 2), made_up_scan(config, 3), config)\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PROJECT_ROOT, env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    assert "first compiled" in done.stdout
    assert "then" not in done.stdout
