# `make train` and `make test` do everything on a fresh machine: python3 (with venv and pip), make and git are enough.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: help install train test test-slow lint clean

help:
	@echo "make install    create $(VENV) with all that the commands below need (they do it themselves)"
	@echo "make train      train a robot, evaluate it in a room it has never seen, write runs/<name>/report.html"
	@echo "                (8 to 30 minutes on two cores; ARGS='--model S --seed 1' passes settings; interrupted: run it again)"
	@echo "make test       run the test suite"
	@echo "make test-slow  run the checks that take longer"
	@echo "make lint       check style and types"
	@echo "make clean      remove the virtual environment and caches"

$(READY): constraints.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	@touch $@

install: $(READY)

train: $(READY)
	$(BIN)/navsim train --resume $(ARGS)

test: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" --numprocesses auto --dist worksteal $(ARGS)

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow $(ARGS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build *.egg-info
