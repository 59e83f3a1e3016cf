# `make train` and `make test` do everything on a fresh machine.
# PYTHON=... chooses the interpreter; without it the first on the PATH that fits is taken.
VENV := .venv
BIN := $(VENV)/bin

.PHONY: setup lock train test test-fast lint browser docs paper pretrained

# Quick the second time. A lost Vulkan driver is found either way.
setup:
	@bash .ci/setup $(VENV)
	@bash .ci/vulkan $(BIN)/python

# Today's versions for every Python, after a change of pyproject.toml; what is locked stays as it is while it fits.
lock:
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --extra dev --no-annotate \
		--custom-compile-command 'make lock' --output-file constraints.txt pyproject.toml

train: setup
	$(BIN)/python -m xqmap.train +task=landing

# The paper's table: both tasks, three methods, two jobs at a time. What is finished under multirun/paper is not run again.
paper: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m xqmap.train -m +sweep=paper hydra/launcher=parallel

# Trains the agents that run=pretrained/TASK names, with the defaults, and puts what is needed of them into the package.
pretrained: setup
	$(BIN)/python -m xqmap.train -m +sweep=pretrained
	for run in multirun/pretrained/*/; do \
		place=xqmap/pretrained/$$(basename $$run); mkdir -p $$place/checkpoint; \
		cp $$run/checkpoint/policy.safetensors $$place/checkpoint/; cp $$run/evaluation.json $$place/; done

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The browser that tests open pages with, where root can install it; they skip without one.
browser: setup
	@command -v chromium >/dev/null || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null \
		|| { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends chromium; } >/dev/null 2>&1 \
		|| echo "chromium could not be installed: tests that open a page will be skipped"

# What computes shares the two processors with its neighbour, so each process gets one thread. Files begin in the order
# of tests/durations.json; PYTEST_ADDOPTS=--record-durations measures it anew.
test: lint browser
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

# The documentation into site/, without network: a link or an anchor that leads nowhere fails.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

# For every save: what neither simulates nor trains.
test-fast: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 -m "not sim"
