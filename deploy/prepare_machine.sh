#!/usr/bin/env bash
# What cellcal needs of the system: Python 3.11 or newer with venv. Installs it with apt when root, else says so.
set -euo pipefail
python=${PYTHON:-python3}
if "$python" -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
  exit 0
fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "installing python3 and python3-venv with apt …" >&2
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3 python3-venv >/dev/null
  exit 0
fi
echo "cellcal needs Python 3.11 or newer with the venv module. Ask an administrator for: apt-get install python3 python3-venv" >&2
exit 1
