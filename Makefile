# make demo    see it work          make test    all tests, the slow ones too
# make lint    format, types, layers  make clean   remove .venv and every cache
# make docs    the manual, in build/manual
# make bench   the benchmarks against every peer: fills .venv with Open3D and small_gicp, fifteen minutes
#
# .venv is made and filled by the first target that needs it. PYTHON=/path/to/python chooses another one.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help demo test lint docs bench venv clean

# Where the environment forbids it, every process would compile all that it imports anew: three seconds each.
unexport PYTHONDONTWRITEBYTECODE
PYTHON ?=
# Of the tests: one more than two cores, for some do nothing but wait for other processes.
WORKERS ?= 3
BIN := .venv/bin
STAMP := .venv/filled

help:
	@sed -n 's/^# \?//p' Makefile | sed '/^$$/,$$d'

demo: $(STAMP)
	@$(BIN)/handsight demo

test: $(STAMP)
	@$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

lint: $(STAMP)
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

docs: $(STAMP)
	@$(BIN)/sphinx-build -q -E -W --keep-going -b html docs build/manual
	@echo build/manual/index.html

bench: $(STAMP)
	@PIP_ROOT_USER_ACTION=ignore $(BIN)/python -m pip install -qq --disable-pip-version-check -e '.[bench]'
	@$(BIN)/python -m benchmarks

venv: $(STAMP)

# The stamp holds this folder's path and pyproject.toml: a checkout that was moved gets a new .venv, and a
# pyproject.toml that only looks newer (a fresh clone, a branch and back) installs nothing and needs no network.
ifneq ($(shell head -n 1 $(STAMP) 2>/dev/null),$(CURDIR))
.PHONY: $(STAMP)
endif
$(STAMP): pyproject.toml
	@if [ -f $@ ] && $(BIN)/python -c '' 2>/dev/null && { echo '$(CURDIR)'; cat pyproject.toml; } | cmp -s - $@; then \
	    touch $@; exit 0; \
	fi; \
	if ! $(BIN)/python -m pip --version >/dev/null 2>&1 || { [ -f $@ ] && [ "$$(head -n 1 $@)" != '$(CURDIR)' ]; }; then \
	    chosen=; \
	    for candidate in $(if $(PYTHON),'$(PYTHON)',python3.13 python3.12 python3.11 python3 python); do \
	        if "$$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then \
	            chosen=$$candidate; break; \
	        fi; \
	    done; \
	    if [ -z "$$chosen" ]; then \
	        echo "handsight needs Python 3.11 or newer; found none$(if $(PYTHON), at $(PYTHON),). Install one, or name it: make PYTHON=/path/to/python" >&2; exit 1; \
	    fi; \
	    if ! "$$chosen" -c 'import venv, ensurepip' >/dev/null 2>&1; then \
	        echo "$$chosen has no venv module; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; \
	    fi; \
	    echo "Making .venv with $$("$$chosen" --version) ..."; \
	    "$$chosen" -m venv --clear .venv; \
	fi; \
	echo "Installing handsight and its tools into .venv (a minute, needs the network) ..."; \
	PIP_ROOT_USER_ACTION=ignore $(BIN)/python -m pip install -qq --no-compile --disable-pip-version-check -e '.[dev]'; \
	{ echo '$(CURDIR)'; cat pyproject.toml; } > $@

clean:
	rm -rf .venv build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .kernel_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
