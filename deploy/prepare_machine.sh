#!/usr/bin/env bash
# What cellcal needs of the system: Python 3.11 or newer with venv; with the argument `tests` also a browser and a Chinese
# font, in which the tests look at the pages. Installs with apt when root, else says so.
set -euo pipefail
python=${PYTHON:-python3}

can_install() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }

install() {
  echo "installing $* with apt …" >&2
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

has_browser() { command -v chromium >/dev/null || command -v chromium-browser >/dev/null; }

prepare_tests() {
  has_browser && return
  if can_install && install chromium fonts-wqy-microhei && has_browser; then
    return
  fi
  # No end: every other test can run, and those of the pages say the same.
  echo "The tests of the web pages need Chromium. Ask an administrator for: apt-get install chromium fonts-wqy-microhei" >&2
}

if ! "$python" -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
  if ! can_install; then
    echo "cellcal needs Python 3.11 or newer with the venv module. Ask an administrator for: apt-get install python3 python3-venv" >&2
    exit 1
  fi
  install python3 python3-venv
fi
if [ "${1:-}" = tests ]; then
  prepare_tests
fi
