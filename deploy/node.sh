# Sourced by scripts that need Node, from the repository's root: takes the machine's Node 20.19 or newer, or fetches a
# pinned one into .venv. `quietly COMMAND…` says nothing unless it fails.
bin=${VENV:-.venv}/bin
fits() { "$1" -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 20 || (a == 20 && b >= 19) ? 0 : 1)' 2>/dev/null; }
quietly() {
  local said
  if ! said=$("$@" 2>&1); then
    printf '%s\n' "$said" >&2
    echo "$* failed." >&2
    exit 1
  fi
}
if ! { command -v npm >/dev/null && fits node; }; then
  echo "fetching Node …" >&2
  quietly "$bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-build.lock
  export PATH="$(cd "$bin" && pwd):$PATH"
fi
