# Two commands set everything up: `make study` and `make test`. Needs only Python >= 3.11 with venv, pip, make and git.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: study test lint types imports notebooks benchmarks lab wheel check clean

study: $(VENV)/.package
	$(BIN)/ltvpneu study

# Two at a time, files kept together: each process compiles what its files need.
test: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(VENV)/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/nbstripout --verify notebooks/*.ipynb

types: $(VENV)/.dev
	$(BIN)/pyright --pythonpath $(BIN)/python

imports: $(VENV)/.dev
	$(BIN)/lint-imports

notebooks: $(VENV)/.test
	$(BIN)/python -m pytest tests/test_notebooks.py

benchmarks: $(VENV)/.test
	$(BIN)/python -m pytest benchmarks --benchmark-only -s

lab: $(VENV)/.package
	$(BIN)/python -m pip install --quiet --editable '.[notebooks]'
	$(BIN)/jupyter lab notebooks

# A wheel for this Python with the kernels in it, compiled for any processor of this kind; CPU names what that is.
CPU ?= generic
wheel: $(VENV)/.package
	$(BIN)/python -m pip install --quiet 'wheel>=0.45'
	rm -rf build && mkdir -p build
	NUMBA_CPU_NAME=$(CPU) NUMBA_CACHE_DIR=build/cache $(BIN)/python -c "from ltvpneu.face.warm import ship; ship('build/_kernels')"
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/plain .
	$(BIN)/python -m wheel unpack --dest build/tree build/plain/*.whl
	cp -r build/_kernels build/tree/*/ltvpneu/
	mkdir -p dist && $(BIN)/python -m wheel pack --dest-dir dist build/tree/*
	$(BIN)/python -c "from packaging.tags import sys_tags as tags; t = next(tags()); print(t.interpreter, t.abi, t.platform)" > build/tags
	read -r python abi platform < build/tags && $(BIN)/python -m wheel tags --remove \
		--python-tag $$python --abi-tag $$abi --platform-tag $$platform dist/ltvpneu-*-py3-none-any.whl

check: lint types imports test

# An environment is made once and brought up to date when the requirements change.
$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.package: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.test: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $@ $(VENV)/.package

$(VENV)/.dev: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@ $(VENV)/.test $(VENV)/.package

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .benchmarks study build dist
	find ltvpneu tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +
