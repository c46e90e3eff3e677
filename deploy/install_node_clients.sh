#!/usr/bin/env bash
# Installs the clients of others that tests run with Node (tests/node_clients): node-opcua.
set -euo pipefail
cd "$(dirname "$0")/.."
source deploy/node.sh
echo "installing the Node clients of the tests …" >&2
quietly npm --prefix tests/node_clients ci --no-progress --loglevel=error
touch tests/node_clients/node_modules/.package-lock.json
