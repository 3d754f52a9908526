# `make demo` and `make test` need only Python 3.10-3.13 and make; everything else is installed into .venv.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
DATA   ?= $(RISKPLAN_DATA)

.PHONY: demo test slow lint types check bench wheel clean

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -e ".[predictor,commonroad,data,simulator,video,cluster,completion,docs,dev]"
	touch $(STAMP)

# numba's cache looks at the file of a kernel only, not at the kernels it calls: drop it when any of them is newer
KERNELS := $(wildcard checkers/kernels/*.py checkers/backends/*.py riskplan/kernels/*.py)
$(VENV)/.kernels: $(STAMP) $(KERNELS)
	find checkers riskplan -name '*.nb[ic]' -delete
	touch $@

demo: $(VENV)/.kernels
	$(BIN)/riskplan demo --out out/demo

test: $(VENV)/.kernels
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist loadfile

slow: $(VENV)/.kernels
	$(BIN)/python -m pytest -m slow

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/lint-imports

types: $(STAMP)
	$(BIN)/mypy

check: lint types test

# the tables of the README; BENCH_ARGS="--files 4 --long 0" for a quick look
bench: $(VENV)/.kernels
	$(BIN)/python -m benchmarks.planning --data "$(DATA)" $(BENCH_ARGS)

wheel: $(STAMP)
	$(BIN)/python -m build --wheel --outdir dist .

clean:
	rm -rf $(VENV) out dist build
