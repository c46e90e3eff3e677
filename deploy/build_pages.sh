#!/usr/bin/env bash
# Builds the web pages into the Python package (service/web/dist). Takes the machine's Node 20.19 or newer, or fetches a
# pinned one into .venv. Nobody who only runs cellcal needs Node.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=${VENV:-.venv}/bin
fits() { "$1" -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 20 || (a == 20 && b >= 19) ? 0 : 1)' 2>/dev/null; }
if ! { command -v npm >/dev/null && fits node; }; then
  echo "fetching Node to build the web pages …" >&2
  "$bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-build.lock
  export PATH="$PWD/$bin:$PATH"
fi
echo "building the web pages …" >&2
npm --prefix web ci --no-progress --loglevel=error >/dev/null
npm --prefix web run --silent check >/dev/null || { npm --prefix web run check; exit 1; }
npm --prefix web run --silent build >/dev/null
touch service/web/dist/index.html
