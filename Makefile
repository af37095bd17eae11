# make demo          set everything up, then run the embedded SUITE study
# make test          set everything up, then pass the tests: fixed seeds, two workers, the same cases every time
# make test-demo     what the embedded study leaves and reaches, walked once in its quick form
# make test-long     every test, slow campaigns and documentation examples too, and what they print
# make test-fresh    the tests that draw, on DRAWS fresh seeds; every failure with the seed that repeats it
# make test-kernels  the numerical rooms under each of OpenBLAS's kernel families that this processor can run
# make test-docs     the examples of README, docs and docstrings
# make docs         the documentation as a site in docs/_build/html: built with -W, links checked, search works offline
# make test-web      the pages: what a browser is given
# make lint          style, types and the contracts between rooms
# make kernels       set everything up and compile, once, what tests and study run
# `demo` and `test` need only Python >= 3.11 and make; after the first run they work offline.
PYTHON ?= python3
OUT ?= demo
ARGS ?=
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= 2
DRAWS ?= 5
# Each worker takes tests in order and, when it has none left, half of the other's: what a file sets up is shared.
SIDE_BY_SIDE := -n $(WORKERS) --dist worksteal
# Dozens of processes start in a run: byte code is kept, beside the packages and out of the sources, even where the
# environment forbids it, for without it each of them compiles numpy, scipy and numba again, 1.5 processor seconds.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(abspath $(VENV))/bytecode
KERNELS := $(shell grep -rlE "njit|^@compiled" src --include=*.py)

.PHONY: demo test test-demo test-long test-fresh test-kernels docs test-docs test-web lint kernels bench format lock clean

demo: $(VENV)/run.stamp
	$(BIN)/ultraquiet demo --out $(OUT) $(ARGS)

test: $(VENV)/kernels.stamp
	$(BIN)/python -m pytest -m "not slow and not demo" $(SIDE_BY_SIDE) $(ARGS)

test-demo: $(VENV)/kernels.stamp
	$(BIN)/python -m pytest -m "demo and not slow" $(SIDE_BY_SIDE) $(ARGS)

test-long: $(VENV)/full.stamp
	$(BIN)/python -m pytest -rP $(SIDE_BY_SIDE) $(ARGS)

test-fresh: $(VENV)/kernels.stamp
	$(BIN)/python tests/fresh_draws.py --draws $(DRAWS) $(SIDE_BY_SIDE) $(ARGS)

test-kernels: $(VENV)/kernels.stamp
	$(BIN)/python tests/kernel_families.py $(SIDE_BY_SIDE) $(ARGS)

docs: $(VENV)/full.stamp
	$(BIN)/python -m sphinx -W --keep-going -n -q -b html docs docs/_build/html

test-docs: $(VENV)/full.stamp docs
	$(BIN)/python -m pytest src $(SIDE_BY_SIDE) $(ARGS)
	$(BIN)/python -m pytest -m docs $(SIDE_BY_SIDE) $(ARGS)

test-web: $(VENV)/full.stamp
	$(BIN)/python -m pytest -m web $(ARGS)

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --no-cache --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

kernels: $(VENV)/kernels.stamp

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/dev.stamp
	$(BIN)/python -m benchmarks $(ARGS)

$(VENV)/run.stamp: requirements/run.lock pyproject.toml
	$(PYTHON) requirements/setup.py $(VENV) requirements/run.lock
	@touch $@

$(VENV)/dev.stamp: requirements/dev.lock pyproject.toml
	$(PYTHON) requirements/setup.py $(VENV) requirements/dev.lock
	@touch $@ $(VENV)/run.stamp

# What only pages and documentation need: a browser's driver, a page builder.
$(VENV)/full.stamp: $(VENV)/kernels.stamp requirements/full.lock
	$(PYTHON) requirements/setup.py $(VENV) requirements/full.lock
	@touch $@

$(VENV)/kernels.stamp: $(VENV)/dev.stamp tests/compile_kernels.py $(KERNELS)
	$(BIN)/python tests/compile_kernels.py
	@touch $@

clean:
	rm -rf $(VENV) demo dist docs/_build docs/reference/api docs/gallery .pytest_cache .ruff_cache .hypothesis

lock: # renew the lock files; needs uv
	uv pip compile -q --universal --python-version 3.11 --no-emit-index-url --no-header --group build pyproject.toml -o requirements/run.lock
	uv pip compile -q --universal --python-version 3.11 --no-emit-index-url --no-header --group build --group test --group lint pyproject.toml -o requirements/dev.lock
	uv pip compile -q --universal --python-version 3.11 --no-emit-index-url --no-header --group build --group test --group lint --group docs --group web pyproject.toml -o requirements/full.lock
