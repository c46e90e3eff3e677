# Two commands do everything on a fresh machine: `make demo` and `make test`.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OPENBLAS_NUM_THREADS ?= 1
# Tests and demo start hundreds of processes: the second and all further ones find the modules compiled.
export PYTHONDONTWRITEBYTECODE :=

PAGES := service/web/dist/index.html
NODE_CLIENTS := tests/node_clients/node_modules/.package-lock.json
RUST_CLIENTS := tests/rust_clients/target/.built
# Tests at once: with two of them two processors are a third idle.
WORKERS ?= 3

.PHONY: demo test run-tests check lint type-check soak bench lock pages types clean

$(VENV)/.runtime: requirements.lock pyproject.toml
	@./deploy/prepare_machine.sh
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing cellcal into $(VENV) …" >&2
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

$(VENV)/.dev: requirements-dev.lock $(VENV)/.runtime
	@./deploy/prepare_machine.sh tests
	@echo "installing the test tools into $(VENV) …" >&2
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

# Node is needed only here and for the clients below; where none is installed, a pinned one comes from the package registry.
$(PAGES): $(VENV)/.runtime web/package-lock.json web/index.html web/fleet.html web/vite.config.ts web/chinese_font.mjs $(shell find web/src web/public -type f)
	@./deploy/build_pages.sh

pages: $(PAGES)

# Clients of others that the tests run with Node.
$(NODE_CLIENTS): $(VENV)/.runtime tests/node_clients/package-lock.json
	@./deploy/install_node_clients.sh

# A client and a server of others that tests run as Rust programs, where cargo is installed.
$(RUST_CLIENTS): tests/rust_clients/Cargo.lock tests/rust_clients/src/main.rs tests/rust_clients/src/bin/mock-yaskawa.rs
	@./deploy/install_rust_clients.sh

# In a terminal it opens the pages until Ctrl-C; anywhere else it tells the story and ends.
demo: $(VENV)/.runtime
	@if [ -t 2 ] && [ -z "$${CI:-}" ]; then $(MAKE) --no-print-directory pages || true; fi
	@$(BIN)/cellcal demo $(ARGS)

# The type check, which alone takes minutes, runs beside the tests: they wait for devices for a part of their time.
test: lint
	@$(MAKE) --no-print-directory -j 2 type-check run-tests

run-tests: $(VENV)/.dev $(PAGES) $(NODE_CLIENTS) $(RUST_CLIENTS)
	@$(BIN)/python -m pytest tests -m "not soak" -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

check: lint type-check

lint: $(VENV)/.dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-cache

type-check: $(VENV)/.dev
	@$(BIN)/mypy

# Long campaigns: each prints its figure on the last line.
soak: $(VENV)/.dev
	@$(BIN)/python -m tests.soak $(ARGS)

bench: $(VENV)/.dev service/web/dist/index.html
	@$(BIN)/cellcal bench $(ARGS)
	@test -n "$(ARGS)" || $(BIN)/python -m tests.benchmarks.bench_commands
	@test -n "$(ARGS)" || $(BIN)/python -m tests.benchmarks.bench_routes
	@test -n "$(ARGS)" || $(BIN)/python -m tests.benchmarks.bench_pages

# Types and names of the pages are written from what the service and the procedures say of themselves.
types: $(VENV)/.runtime
	@$(BIN)/python deploy/typescript_types.py
	@$(BIN)/python deploy/page_labels.py
	@$(BIN)/python deploy/evidence_table.py

# The locks name packages and hashes, and no registry host.
lock:
	uv pip compile -q --generate-hashes --no-emit-index-url --no-header --python-version 3.11 pyproject.toml -o requirements.lock
	uv pip compile -q --generate-hashes --no-emit-index-url --no-header --extra dev --python-version 3.11 pyproject.toml -o requirements-dev.lock
	uv pip compile -q --generate-hashes --no-emit-index-url --no-header --universal --python-version 3.11 requirements-build.in -o requirements-build.lock

clean:
	rm -rf $(VENV) build *.egg-info
