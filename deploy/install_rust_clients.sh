#!/usr/bin/env bash
# Builds what tests run as Rust programs of others (tests/rust_clients): moto-hses-client and moto-hses-mock.
# Where nothing is built the tests are skipped, and the next `make test` tries again.
set -euo pipefail
cd "$(dirname "$0")/.."
mkdir -p tests/rust_clients/target
command -v cargo >/dev/null || exit 0
echo "building the Rust programs of the tests …" >&2
if cargo build --quiet --locked --manifest-path tests/rust_clients/Cargo.toml; then
  touch tests/rust_clients/target/.built
else
  echo "they were not built: their tests are skipped" >&2
fi
