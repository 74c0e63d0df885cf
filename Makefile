# Two commands set everything up: `make study` and `make test`. Needs only Python >= 3.11 with venv, pip, make and git.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: study test lint types imports notebooks benchmarks lab check clean

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
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .benchmarks study
	find ltvpneu tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +
