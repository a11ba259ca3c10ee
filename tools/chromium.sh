#!/usr/bin/env bash
# chromium.sh: installs Chromium, in which the tests look at report.html, if there is no browser of its kind and if that
# is allowed. Never fails: without it those tests are skipped, and everything else works.
set -u

for name in "${CHROMIUM:-chromium}" chromium chromium-browser google-chrome google-chrome-stable; do
  if command -v "$name" >/dev/null 2>&1; then
    exit 0
  fi
done

skipped() {
  echo "note: $1; the tests of report.html in a browser will be skipped"
  echo "      to have them:  sudo apt-get install -y --no-install-recommends chromium"
  exit 0
}

command -v apt-get >/dev/null 2>&1 || skipped "no Chromium found, and no apt-get to install it with"
if [ "$(id -u)" = 0 ]; then
  as_root=""
elif sudo -n true 2>/dev/null; then
  as_root="sudo -n"
else
  skipped "no Chromium found, and no right to install it"
fi

export DEBIAN_FRONTEND=noninteractive
patience="-o Acquire::Retries=1 -o Acquire::http::Timeout=20" # a machine without a network must not wait for long
install() {
  # shellcheck disable=SC2086  # one word each
  $as_root apt-get $patience install -q -y --no-install-recommends chromium </dev/null >/dev/null 2>&1
}
update() {
  # shellcheck disable=SC2086
  $as_root apt-get $patience update -q </dev/null >/dev/null 2>&1
}

echo "tests look at the report in a browser: apt-get install chromium"
install || { update && install; } || skipped "chromium could not be installed"
