# make demo   set everything up, then run the embedded SUITE study
# make test   set everything up, then pass the tests
# Both need only Python >= 3.11 and make; after the first run they work offline.
PYTHON ?= python3
OUT ?= demo
ARGS ?=
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-long lint bench format lock clean

demo: $(VENV)/run.stamp
	$(BIN)/ultraquiet demo --out $(OUT) $(ARGS)

test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -m "not slow" $(ARGS)

test-long: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -s $(ARGS)

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

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

clean:
	rm -rf $(VENV) demo dist .pytest_cache .ruff_cache .hypothesis

lock: # renew the lock files; needs uv
	uv pip compile -q --universal --python-version 3.11 --no-emit-index-url --no-header --group build pyproject.toml -o requirements/run.lock
	uv pip compile -q --universal --python-version 3.11 --no-emit-index-url --no-header --group build --group test --group lint pyproject.toml -o requirements/dev.lock
