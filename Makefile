# Both `make demo` and `make test` set up .venv themselves; they need Python 3.11+ and the package index.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

PYTEST := $(BIN)/pytest -n auto --dist worksteal
# The marks of pyproject.toml: what takes long, or needs a program that not everybody has.
RARE := study or browser or dask or kill or memory

# The tests start hundreds of processes. Without bytecode, which images of containers like to switch off, each of them
# would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo docs docs-links test test-all test-every test-rest lint bench licences lock test-lowest test-newest manifests clean

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

# Notebooks run again only where they, or this folder's settings, have changed; what is odd fails the build.
SPHINX := $(BIN)/sphinx-build -W --keep-going -d docs/_build/doctrees $(SPHINXOPTS)

docs: $(STAMP)  ## The documentation's site, into docs/_build/html; without running notebooks: SPHINXOPTS='-D nb_execution_mode=off'
	$(SPHINX) docs docs/_build/html

docs-links: $(STAMP)  ## Whether the addresses in the documents answer (needs the network; links between pages are checked by make docs)
	$(SPHINX) -b linkcheck -D nb_execution_mode=off docs docs/_build/links

lint: $(STAMP)  ## Style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy examples/*.py docs/conf.py docs/site/*.py

test: lint  ## Style, types and every test that is quick, in about ten minutes on two cores
	$(PYTEST) -m 'not ($(RARE))'

test-all: lint test-every  ## The same with long studies and tests of browser, Dask, kills and memory

test-every: $(STAMP)
	$(PYTEST)

test-rest: $(STAMP)
	$(PYTEST) -m '$(RARE)'

bench: $(STAMP)  ## Benchmarks against the straightforward routes, about twenty minutes
	$(BIN)/python -m benchmarks

lock:  ## Resolve requirements-dev.txt again: what pyproject.toml asks for now; newer releases with UPGRADE=--upgrade
	$(PYTHON) -m venv .venv-lock
	.venv-lock/bin/pip install --quiet uv==0.13.9
	.venv-lock/bin/uv pip compile --quiet --config-file .ci/uv.toml --constraint constraints.txt $(UPGRADE) \
	  --output-file requirements-dev.txt pyproject.toml
	rm -rf .venv-lock

licences: $(STAMP)  ## Write docs/licences.md again
	$(BIN)/python .ci/licences.py > docs/licences.md

# As the weekly jobs of these names do, but with the torch of constraints.txt: another one may bring gigabytes of GPU libraries.
test-lowest:  ## The quick tests with the oldest releases that pyproject.toml allows
	$(PYTHON) -m venv --clear .venv-lowest
	$(PYTHON) .ci/lowest.py | sed "s/^torch==.*/$$(grep ^torch== constraints.txt)/" > .venv-lowest/lowest.txt
	.venv-lowest/bin/pip install --quiet --constraint .venv-lowest/lowest.txt torch
	.venv-lowest/bin/pip install --quiet --constraint .venv-lowest/lowest.txt --editable '.[dev]'
	.venv-lowest/bin/pytest -n auto --dist worksteal -m 'not ($(RARE))'

test-newest:  ## The quick tests with the newest releases
	$(PYTHON) -m venv --clear .venv-newest
	.venv-newest/bin/pip install --quiet "$$(grep ^torch== constraints.txt)"
	.venv-newest/bin/pip install --quiet --upgrade --upgrade-strategy only-if-needed --editable '.[dev]'
	.venv-newest/bin/pytest -n auto --dist worksteal -m 'not ($(RARE))'

manifests: $(STAMP)  ## Write the shipped manifests again
	$(BIN)/python -m manifests.generate

clean:  ## Remove what make made
	rm -rf $(VENV) docs/_build .venv-lock .venv-lowest .venv-newest eldata-demo .mypy_cache .ruff_cache .pytest_cache
