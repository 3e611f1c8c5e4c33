# Both `make demo` and `make test` set up .venv themselves; they need Python 3.11+ and the package index.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

PYTEST := $(BIN)/pytest -n auto --dist worksteal
# The marks of pyproject.toml: what takes long, or needs a program that not everybody has.
RARE := study or browser or tether or dask or kill or memory

# The tests start hundreds of processes. Without bytecode, which images of containers like to switch off, each of them
# would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all test-rest lint bench fuzz manifests clean

help:  ## What there is to make
	@grep -hE '^[a-z-]+:.*##' Makefile | sed 's/:.*## /\t/' | expand -t 12

# Every package but torch by its hash, and none is built here (.ci/uv.toml says why torch is apart). An editable package has
# no hash: eldata itself comes last, with the locked build backend.
$(STAMP): pyproject.toml constraints.txt requirements-dev.txt
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-deps --require-hashes --only-binary :all: --requirement requirements-dev.txt
	$(BIN)/pip install --quiet --constraint constraints.txt torch==2.13.0
	$(BIN)/pip install --quiet --no-deps --no-build-isolation --editable .
	$(BIN)/pip check --quiet
	touch $@

demo: $(STAMP)  ## The whole path on simulated raw files, into ./eldata-demo
	$(BIN)/eldata demo eldata-demo

lint: $(STAMP)  ## Style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint  ## Style, types and every test that is quick, in five minutes or less on two cores
	$(PYTEST) -m 'not ($(RARE))'

test-all: test test-rest  ## The same, then long studies and tests of browser, tether, Dask, kills and memory

test-rest: $(STAMP)
	$(PYTEST) -m '$(RARE)'

bench: $(STAMP)  ## Benchmarks against the straightforward routes, about twenty minutes
	$(BIN)/python -m benchmarks

# How long it runs. For exact counts and one's own seed: .venv/bin/python -m tests.fuzz --help
MINUTES ?= 10

fuzz: $(STAMP)  ## Damaged and hostile files for so long (MINUTES=10); the failing ones go to ./fuzz-failures (Linux only)
	$(BIN)/python -m tests.fuzz --minutes $(MINUTES)

manifests: $(STAMP)  ## Write the shipped manifests again
	$(BIN)/python -m manifests.generate

clean:  ## Remove what make made
	rm -rf $(VENV) eldata-demo .mypy_cache .ruff_cache .pytest_cache
