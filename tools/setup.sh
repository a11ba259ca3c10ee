#!/usr/bin/env bash
# setup.sh MODE: makes or updates .venv with pinned versions. MODE is "wheels" (rclpy from wheels, no ROS on the
# machine) or "apt" (a ROS is sourced: its rclpy is used, and wheels of another build must not come near it).
set -eu

cd "$(dirname "$0")/.."
mode=${1:-wheels}
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE # set by the wheels' start-up for its own children; another environment must not see it

usable() { # an environment of the right kind, whose Python still runs
  local wanted=false
  if [ "$mode" = apt ]; then wanted=true; fi
  [ -f .venv/pyvenv.cfg ] &&
    grep -q "^include-system-site-packages = $wanted" .venv/pyvenv.cfg &&
    .venv/bin/python -c 'import sys, pip; sys.exit(not (3, 10) <= sys.version_info < (3, 14))' >/dev/null 2>&1 </dev/null
}

if ! usable; then
  python=$(tools/find_python.sh "$mode")
  echo "making .venv with $("$python" --version) ($python)"
  if [ "$mode" = apt ]; then
    "$python" -m venv --clear --system-site-packages .venv
  else
    "$python" -m venv --clear .venv
  fi
fi
touch .venv/COLCON_IGNORE # colcon must not look for packages in here

minor=$(.venv/bin/python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
pins=constraints/py$minor.txt
extras=test,dev,las,e57,report,compare,cluster
if [ "$minor" != 3.10 ]; then extras=$extras,graph; fi # its wheels for 3.10 need numpy 1, the pins are of numpy 2
if [ "$mode" = apt ]; then
  pins=constraints/py$minor-apt-ros.txt
  [ -f "$pins" ] || pins=constraints/any-apt-ros.txt
  echo "a ROS is sourced (${ROS_DISTRO:-unnamed}): .venv uses its rclpy and the system's packages; the ROS wheels are not installed"
elif [ "$(uname -s)-$(uname -m)" = Linux-x86_64 ]; then
  extras=$extras,ros
else
  echo "no ROS wheels exist for $(uname -s) on $(uname -m): the node and its tests need a ROS installed and sourced"
fi

pip_install() {
  .venv/bin/python -m pip install -qq --disable-pip-version-check -c "$pins" "$@" </dev/null
}
echo "installing into .venv (versions of $pins)"
pip_install setuptools
pip_install --no-build-isolation -e ".[$extras]"
tools/system_libraries.sh .venv/bin/python
tools/chromium.sh
.venv/bin/python -m svc_ros.ros.compile_kernels </dev/null ||
  echo "warning: the kernels could not be compiled; that is tried again when they are first needed"
echo "ready: .venv/bin/svc_ros doctor says what works"
