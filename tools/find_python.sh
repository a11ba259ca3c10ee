#!/usr/bin/env bash
# Prints the path of a Python that can make the project's environment: 3.12 first, then 3.13, 3.11, 3.10.
# The variable PYTHON names one instead. Every candidate is run, because a shim can exist and not work, and because
# a distribution may ship Python without venv. Under a sourced ROS only the Python that its rclpy belongs to will do.
set -eu

minors="3.12 3.13 3.11 3.10"
probe='import sys, venv, ensurepip'
if [ "${1:-}" = apt ]; then
  probe="$probe, rclpy"
fi

candidates() {
  local minor=$1 root
  if [ -n "${PYTHON:-}" ]; then
    printf '%s\n' "$PYTHON"
    return
  fi
  printf '%s\n' "python$minor" "/usr/bin/python$minor" "/usr/local/bin/python$minor"
  if root=$(pyenv root 2>/dev/null); then
    ls -d "$root/versions/$minor"*/bin/python 2>/dev/null | sort -rV || true
  fi
  printf '%s\n' python3
}

for minor in $minors; do
  for python in $(candidates "$minor"); do
    check="$probe; print(sys.executable); sys.exit(sys.version_info[:2] != (3, ${minor#3.}))"
    if found=$("$python" -c "$check" 2>/dev/null </dev/null) && [ -n "$found" ]; then
      printf '%s\n' "$found"
      exit 0
    fi
  done
done

{
  echo "error: no usable Python found (tried ${PYTHON:-python3.12, python3.13, python3.11, python3.10}; it must run: $probe)"
  echo "       on Debian or Ubuntu: apt-get install python3 python3-venv; or name one: make setup PYTHON=/path/to/python3.12"
} >&2
exit 1
