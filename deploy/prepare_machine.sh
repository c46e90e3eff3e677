#!/usr/bin/env bash
# What cellcal needs of the system: Python 3.11 or newer with venv; with the argument `tests` also a browser and a Chinese
# font, in which the tests look at the pages. Installs with apt when root, else says so.
set -euo pipefail
python=${PYTHON:-python3}

# Chromium without windows opens a page in a quarter of the processor time. Where it cannot be had, the whole one does.
windowless_browser=chromium-headless-shell

can_install() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }

install() {
  echo "installing $* with apt …" >&2
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

has_browser() { command -v chromium >/dev/null || command -v chromium-browser >/dev/null; }

has_chinese_font() {
  if command -v fc-list >/dev/null; then
    [ -n "$(fc-list :lang=zh)" ]
  else
    [ -n "$(find /usr/share/fonts /usr/local/share/fonts "${HOME:-/root}/.fonts" -iregex '.*\(wqy\|cjk\|hansans\).*' -print -quit 2>/dev/null)" ]
  fi
}

prepare_tests() {
  local lacks=()
  if ! command -v "$windowless_browser" >/dev/null && can_install; then
    install "$windowless_browser" 2>/dev/null || true
  fi
  has_browser || lacks+=(chromium)
  has_chinese_font || lacks+=(fonts-wqy-microhei)
  [ ${#lacks[@]} = 0 ] && return
  if can_install && install "${lacks[@]}" && has_browser && has_chinese_font; then
    return
  fi
  # No end: every other test can run, and those of the pages say the same.
  echo "The tests of the web pages need Chromium and a Chinese font. Ask an administrator for: apt-get install ${lacks[*]}" >&2
}

if ! "$python" -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
  if ! can_install; then
    echo "cellcal needs Python 3.11 or newer with the venv module. Ask an administrator for: apt-get install python3 python3-venv" >&2
    exit 1
  fi
  if ! install python3 python3-venv; then
    echo "Python 3.11 or newer with the venv module could not be installed. Ask an administrator for: apt-get install python3 python3-venv" >&2
    exit 1
  fi
fi
if [ "${1:-}" = tests ]; then
  prepare_tests
fi
