"""Build of the ament_python package svc_ros, for colcon and for pip."""

import re
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "svc_ros"
HERE = Path(__file__).resolve().parent

# Open3D's wheel without CUDA is a tenth of the full one, and exists for this platform only.
LIGHT_OPEN3D = "platform_system == 'Linux' and platform_machine == 'x86_64'"
FULL_OPEN3D = "platform_system != 'Linux' or platform_machine != 'x86_64'"


def read_version() -> str:
    """The version stands in svc_ros/__init__.py; reading it must not import the package's dependencies."""
    text = (HERE / PACKAGE / "__init__.py").read_text(encoding="utf-8")
    found = re.search(r'^__version__ = "([^"]+)"$', text, re.MULTILINE)
    if found is None:
        raise SystemExit(f"{PACKAGE}/__init__.py: expected a line __version__ = \"...\"")
    return found.group(1)


def shared_files() -> list:
    """What goes to share/: the ament marker, the manifest, launch files, presets and layouts."""
    share = f"share/{PACKAGE}"
    wanted = {
        "share/ament_index/resource_index/packages": [f"resource/{PACKAGE}"],
        share: ["package.xml"],
        f"{share}/launch": sorted(glob("launch/*.py")),
        f"{share}/config": sorted(name for name in glob("config/*") if Path(name).is_file()),
    }
    return [(folder, names) for folder, names in wanted.items() if names]


setup(
    name=PACKAGE,
    version=read_version(),
    description="Global registration of LiDAR scans with a verdict from sight lines, for ROS 2 and the command line",
    long_description="Registers two point clouds from any starting pose and says whether the answer can be trusted.",
    license="Apache-2.0",
    author="The svc_ros authors",
    maintainer="The svc_ros authors",
    maintainer_email="maintainers@svc-ros.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "report/page/*"]},
    data_files=shared_files(),
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.60",
        f"open3d-cpu>=0.18; {LIGHT_OPEN3D}",
        f"open3d>=0.18; {FULL_OPEN3D}",
        "rosbags>=0.11",
        "lz4>=4",
        "backports.zstd>=1; python_version < '3.14'",
        "kiss-icp>=1.2",
        "small-gicp>=1.0",
        "pyyaml>=6.0",
        "typer>=0.12",
        "rich>=13",
        "matplotlib>=3.8",
    ],
    extras_require={
        "test": [
            "pytest>=8",
            "pytest-xdist>=3.5",
            "hypothesis>=6.100",
            "packaging>=23",
            "mcap>=1.2",
            "websocket-client>=1.6",
            "colcon-core>=0.18",
            "colcon-ros>=0.5",
            "colcon-python-setup-py>=0.2.9",
            "colcon-recursive-crawl>=0.2.3",
            "colcon-test-result>=0.3.8",
        ],
        # Real rclpy with its middleware, for Linux machines that have no ROS; never beside an apt ROS.
        "ros": [
            "ros-jazzy-rclpy[fastrtps]",
            "ros-jazzy-sensor-msgs",
            "ros-jazzy-geometry-msgs",
            "ros-jazzy-std-msgs",
            "ros-jazzy-std-srvs",
            "ros-jazzy-nav-msgs",
            "ros-jazzy-diagnostic-msgs",
            "ros-jazzy-visualization-msgs",
            "ros-jazzy-lifecycle-msgs",
        ],
        # On Python 3.10 the newest wheels are built for numpy 1, and end the process beside numpy 2.
        "graph": [
            "gtsam>=4.3; python_version >= '3.11'",
            "gtsam>=4.2.1,<4.3; python_version < '3.11'",
            "numpy<2; python_version < '3.11'",
        ],
        "las": ["laspy[lazrs]>=2.5"],
        # On other Linux machines it has no wheels, and its sources need a C++ build.
        "e57": ["pye57>=0.4.14; platform_system != 'Linux' or platform_machine == 'x86_64'"],
        "cluster": ["distributed>=2024.5"],
        "report": ["plotly>=5.20", "matplotlib>=3.8", "evo>=1.30"],
        # kiss-matcher has wheels for these only, and its sources need a C++ build.
        "compare": ["kiss-matcher>=1.0; python_version < '3.13' and platform_machine == 'x86_64'", "small-gicp>=1.0"],
        "dev": ["ruff>=0.6", "mypy>=1.10", "types-PyYAML"],
    },
    entry_points={
        "console_scripts": [
            f"{PACKAGE} = {PACKAGE}.cli.main:main",
            f"registration_node = {PACKAGE}.ros.node:main",
            f"bag_player = {PACKAGE}.ros.bag_player:main",
        ],
    },
    classifiers=[
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
        "Operating System :: POSIX :: Linux",
    ],
)
