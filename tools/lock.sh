#!/usr/bin/env bash
# lock.sh [PYTHON ...]: writes constraints/pyX.Y.txt for each interpreter, by resolving the newest versions in a fresh
# environment. "--numpy1 PYTHON" writes constraints/pyX.Y-apt-ros.txt, for a venv over an apt ROS (built for numpy 1).
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

list_installed='
import importlib.metadata as metadata, re
rows = {}
for dist in metadata.distributions():
    name = dist.metadata["Name"]
    if dist.read_text("INSTALLER") and name not in ("pip", "svc_ros"):  # wheels may carry metadata of packages in them
        rows[re.sub(r"[-_.]+", "-", name).lower()] = dist.version.split("+")[0]
if "open3d-cpu" in rows:
    rows["open3d"] = rows["open3d-cpu"]  # the same version where the light wheel does not exist
print("\n".join(f"{name}=={version}" for name, version in sorted(rows.items())))
'

lock() { # lock PYTHON FLAVOUR
  local python=$1 flavour=$2 minor extras=test,dev,las,e57,report,compare,cluster limit=
  minor=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  local venv=$scratch/$minor$flavour out=$root/constraints/py$minor$flavour.txt
  if [ "$minor" != 3.10 ]; then extras=$extras,graph; fi # see tools/setup.sh
  if [ -z "$flavour" ]; then extras=$extras,ros; else limit="numpy<2"; fi
  "$python" -m venv "$venv"
  mkdir "$venv/source"
  (cd "$root" && tar -c setup.py setup.cfg pyproject.toml package.xml resource svc_ros) | tar -x -C "$venv/source"
  "$venv/bin/python" -m pip install -q "setuptools>=70.1,<80"
  # shellcheck disable=SC2086  # the limit is one word or none
  "$venv/bin/python" -m pip install -q --no-build-isolation $limit -e "$venv/source[$extras]"
  {
    echo "# Versions that were installed and tried together on Python $minor${limit:+ with $limit}; written by tools/lock.sh."
    "$venv/bin/python" -c "$list_installed"
  } >"$out"
  "$venv/bin/python" -m pip check
  "$venv/bin/python" -c 'import numpy, scipy, numba, open3d, kiss_icp, rosbags'
  rm -rf "$venv"
  echo "wrote $out"
}

flavour=
for argument in "$@"; do
  case "$argument" in
    --numpy1) flavour=-apt-ros ;;
    *)
      lock "$argument" "$flavour"
      flavour=
      ;;
  esac
done
