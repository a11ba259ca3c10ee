"""Installed packages that offer descriptors, made for tests: a module, and the metadata that pip writes."""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

from places import TESTS

EXAMPLE = TESTS / "example_descriptor"


def write_package(site: Path, module: str, code: str, **offers: str) -> None:
    """Put a package into a folder of sys.path. offers: names of descriptors and the functions of the module."""
    info = site / f"{module}-1.0.dist-info"
    info.mkdir(parents=True)
    (site / f"{module}.py").write_text(dedent(code))
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    lines = [f"{name} = {module}:{function}" for name, function in offers.items()]
    (info / "entry_points.txt").write_text("\n".join(["[svc_ros.descriptors]", *lines, ""]))
    importlib.invalidate_caches()  # the folder may have been looked through in this very moment


def install_example(folder: Path) -> Path:
    """Install the example package with pip, without a network, and return the folder that sys.path needs."""
    source, site = folder / "source", folder / "site"
    shutil.copytree(EXAMPLE, source)  # building leaves files beside the source
    flags = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--target", str(site)]
    command = [sys.executable, "-m", "pip", "install", *flags, str(source)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return site
