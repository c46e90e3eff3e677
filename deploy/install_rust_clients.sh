#!/usr/bin/env bash
# Builds the client of others that a test runs as a Rust program (tests/rust_clients): moto-hses-client.
# Without cargo nothing is built, and the test is skipped.
set -euo pipefail
cd "$(dirname "$0")/.."
built=tests/rust_clients/target/.built
mkdir -p tests/rust_clients/target
if command -v cargo >/dev/null; then
  echo "building the Rust client of the tests …" >&2
  if ! cargo build --quiet --locked --manifest-path tests/rust_clients/Cargo.toml; then
    echo "it was not built: its test is skipped" >&2
  fi
fi
touch "$built"
