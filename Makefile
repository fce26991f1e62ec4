# Every target makes what it needs in .venv; a fresh machine needs python3 (>= 3.11, with venv) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# As in visloc's own commands: matrices are small, and there are several processes of tests.
export OPENBLAS_NUM_THREADS ?= 1
# What is compiled is kept: else every process of tests, and all those that tests start, compiles the package anew.
unexport PYTHONDONTWRITEBYTECODE
# Compiled when it is first imported: half of an installation's time goes to modules of which most never are.
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt

.PHONY: install install-train demo test test-train lint bench sitl clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt | $(BIN)/pip
	$(PIP_INSTALL) -e '.[cpu,prep,web,eval,dev]'
	@touch $(STAMP)

# Debian and Ubuntu keep venv in a package of its own, which a fresh machine lacks.
$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: Python 3.11 or newer is needed; set PYTHON=..." >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  package=$$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'); \
	  as_root=; [ "$$(id -u)" -eq 0 ] || as_root=sudo; \
	  echo "$(PYTHON) has no venv module: installing the package $$package (apt-get)" >&2; \
	  { $$as_root apt-get update -qq && $$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$package; } >/dev/null \
	    || { echo "error: no venv module; remedy: apt-get install $$package, or set PYTHON=..." >&2; exit 2; }; }
	@$(PYTHON) -m venv $(VENV)

# PyTorch takes 750 MB, and many times that where the package index only has builds for GPUs; only training needs it.
# Without a GPU: name the index of its builds for CPUs in PIP_EXTRA_INDEX_URL.
install-train: install
	@$(BIN)/python -c 'import torch, onnx, onnxscript' 2>/dev/null || \
	  $(PIP_INSTALL) -e '.[train]'

demo: install
	$(BIN)/visloc demo

test: install
	$(BIN)/pytest -n 3 --dist loadfile # on two cores: some tests wait; tests/distribution.py

test-train: install-train
	$(BIN)/pytest -n 2 --dist loadfile tests/unit/train

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: install
	$(BIN)/python -m benchmarks.all

sitl: install
	$(BIN)/pytest tests/sitl -m sitl -ra

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
