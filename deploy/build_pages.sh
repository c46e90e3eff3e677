#!/usr/bin/env bash
# Builds the web pages into the Python package (service/web/dist). Nobody who only runs cellcal needs Node.
set -euo pipefail
cd "$(dirname "$0")/.."
source deploy/node.sh
echo "building the web pages …" >&2
# What is installed already is not fetched again.
[ web/node_modules/.package-lock.json -nt web/package-lock.json ] || quietly npm --prefix web ci --no-progress --loglevel=error
quietly npm --prefix web run --silent check
quietly npm --prefix web run --silent build
touch service/web/dist/index.html
