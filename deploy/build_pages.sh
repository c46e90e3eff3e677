#!/usr/bin/env bash
# Builds the web pages into the Python package (service/web/dist). Takes the machine's Node 20.19 or newer, or fetches a
# pinned one into .venv. Nobody who only runs cellcal needs Node.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=${VENV:-.venv}/bin
fits() { "$1" -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 20 || (a == 20 && b >= 19) ? 0 : 1)' 2>/dev/null; }
# Says nothing unless it fails.
quietly() {
  local said
  if ! said=$("$@" 2>&1); then
    printf '%s\n' "$said" >&2
    echo "$* failed." >&2
    exit 1
  fi
}
if ! { command -v npm >/dev/null && fits node; }; then
  echo "fetching Node to build the web pages …" >&2
  quietly "$bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-build.lock
  export PATH="$(cd "$bin" && pwd):$PATH"
fi
echo "building the web pages …" >&2
# What is installed already is not fetched again.
[ web/node_modules/.package-lock.json -nt web/package-lock.json ] || quietly npm --prefix web ci --no-progress --loglevel=error
quietly npm --prefix web run --silent check
quietly npm --prefix web run --silent build
touch service/web/dist/index.html
