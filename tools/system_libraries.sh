#!/usr/bin/env bash
# system_libraries.sh PYTHON: makes sure that PYTHON can import open3d, whose wheel expects these of the system.
# Installs them only if the import fails and only where it may; else says what to run, and fails.
set -eu

python=$1
packages="libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"

import_open3d() {
  "$python" -c 'import open3d' 2>&1 >/dev/null </dev/null
}

if output=$(import_open3d); then
  exit 0
fi
error=$(printf '%s\n' "$output" | tail -n 1)
case "$error" in
  *"cannot open shared object file"*) ;;
  *)
    echo "error: open3d is installed, but cannot be imported: $error" >&2
    exit 1
    ;;
esac

if ! command -v apt-get >/dev/null 2>&1; then
  echo "error: $error" >&2
  echo "       install the libraries that Debian calls $packages, then run make setup again" >&2
  exit 1
fi
if [ "$(id -u)" = 0 ]; then
  as_root=""
elif sudo -n true 2>/dev/null; then
  as_root="sudo -n"
else
  echo "error: $error" >&2
  echo "       run this, then make setup again:  sudo apt-get install -y $packages" >&2
  exit 1
fi

echo "open3d needs system libraries: apt-get install $packages"
export DEBIAN_FRONTEND=noninteractive
$as_root apt-get update -q </dev/null >/dev/null
# shellcheck disable=SC2086  # a list of names, one word each
$as_root apt-get install -q -y --no-install-recommends $packages </dev/null >/dev/null
if ! output=$(import_open3d); then
  echo "error: open3d still cannot be imported: $(printf '%s\n' "$output" | tail -n 1)" >&2
  exit 1
fi
