# Both `make demo` and `make test` set up .venv themselves; they need Python 3.11+ and the package index.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help demo test lint bench manifests clean

help:  ## What there is to make
	@grep -hE '^[a-z]+:.*##' Makefile | sed 's/:.*## /\t/' | expand -t 12

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt torch==2.13.0
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(STAMP)  ## The whole path on simulated raw files, into ./eldata-demo
	$(BIN)/eldata demo eldata-demo

lint: $(STAMP)  ## Style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint  ## Style, types and all tests
	$(BIN)/pytest -n auto --dist worksteal

bench: $(STAMP)  ## Benchmarks against the straightforward routes, about twenty minutes
	$(BIN)/python -m benchmarks

manifests: $(STAMP)  ## Write the shipped manifests anew
	$(BIN)/python -m manifests.generate

clean:  ## Remove what make made
	rm -rf $(VENV) eldata-demo .mypy_cache .ruff_cache .pytest_cache
