#!/usr/bin/env bash
# Builds the client of others that a test runs as a Rust program (tests/rust_clients): moto-hses-client.
# Where nothing is built the test is skipped, and the next `make test` tries again.
set -euo pipefail
cd "$(dirname "$0")/.."
mkdir -p tests/rust_clients/target
command -v cargo >/dev/null || exit 0
echo "building the Rust client of the tests …" >&2
if cargo build --quiet --locked --manifest-path tests/rust_clients/Cargo.toml; then
  touch tests/rust_clients/target/.built
else
  echo "it was not built: its test is skipped" >&2
fi
