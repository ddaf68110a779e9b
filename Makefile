# Everything happens in .venv; stamps make the second run start in seconds.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
  $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
WORKERS ?= 2
OBJECTS ?= 15
SOURCES := assets irm planners clutter_env scripts tests

.PHONY: help setup demo test test-slow check compat docs format bench soak results clean

help:
	@echo "make setup      virtual environment with the package, its visuals and the development tools"
	@echo "make demo       one 15-object episode solved in physics by the expert, plan printed, pictures in outputs/"
	@echo "make test       the fast tests, four minutes of CPU time;  make test-slow: all of them"
	@echo "make check      format, lint, types, import contracts, fast tests"
	@echo "make compat     a part of the tests in a new environment: PYTHON=python3.13, or other versions: WITH='mujoco==3.17.0'"
	@echo "make docs       the documentation as pages to read offline, in outputs/site"
	@echo "make bench      speed, memory and rendering of the environments"
	@echo "make results    the results files again, with their page, picture and film, a quarter of an hour"
	@echo "make soak       two million steps through all environments, about an hour"

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11, 3.12 or 3.13 is needed; say which with make PYTHON=..."; exit 1; }
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || { \
	  $(PYTHON) -m venv --clear --without-pip $(VENV) && $(PYTHON) -m pip --python $(BIN)/python install --quiet pip; }

$(VENV)/.core: $(BIN)/python pyproject.toml constraints.txt
	$(PIP) install --quiet --quiet --constraint constraints.txt --editable .
	@touch $@

# In one go with the core. Python compiles files to bytecode when they are first imported: most never are.
$(VENV)/.visuals: $(BIN)/python pyproject.toml constraints.txt
	$(PIP) install --quiet --quiet --no-compile --constraint constraints.txt --editable ".[visuals]"
	@touch $(VENV)/.core $@

$(VENV)/.dev: $(VENV)/.core
	$(PIP) install --quiet --quiet --constraint constraints.txt --editable ".[dev]"
	@touch $@

$(VENV)/.rl: $(VENV)/.core
	$(PIP) install --quiet --quiet --constraint constraints.txt --editable ".[rl,data,ros]"
	@touch $@

setup: $(VENV)/.visuals $(VENV)/.dev $(VENV)/.rl

demo: $(VENV)/.visuals
	$(BIN)/clutter-env episode --objects $(OBJECTS)

# One thread a worker: the networks are small, and more threads only wait for one another.
test: $(VENV)/.dev $(VENV)/.rl
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) --dist loadgroup -m "not slow"

test-slow: $(VENV)/.dev $(VENV)/.rl
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) --dist loadgroup

check: $(VENV)/.dev
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MAKE) test

# WITH names versions in place of those of constraints.txt.
COMPAT := outputs/compat
COMPAT_TESTS := tests/assets tests/irm tests/clutter_env/scene tests/clutter_env/simulation \
  tests/clutter_env/envs tests/planners/test_planner.py tests/planners/expert
compat:
	$(PYTHON) -m venv --clear $(COMPAT)
	$(COMPAT)/bin/python -m pip install --quiet --editable ".[dev,data]" $(if $(WITH),$(WITH),--constraint constraints.txt)
	$(COMPAT)/bin/python -m pip list
	$(COMPAT)/bin/python -m pytest -q $(COMPAT_TESTS) -m "not slow"

format: $(VENV)/.dev
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

$(VENV)/.docs: $(VENV)/.core
	$(PIP) install --quiet --quiet --constraint constraints.txt --editable ".[docs]"
	@touch $@

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@! grep -rlE '<(script|link|img)[^>]*(src|href)="https?:' outputs/site --include='*.html' || { echo "these pages fetch from a server"; exit 1; }
	@echo "documentation: outputs/site/index.html"

bench: $(VENV)/.core
	$(BIN)/clutter-env benchmark

results: $(VENV)/.dev $(VENV)/.rl
	$(BIN)/python scripts/results.py run
	$(BIN)/python scripts/results.py pages
	$(BIN)/python scripts/front_page.py
	$(BIN)/python -m scripts.task_cards

soak: $(VENV)/.core
	$(BIN)/python scripts/soak.py --steps 2000000

clean:
	rm -rf $(VENV) outputs .pytest_cache .ruff_cache .mypy_cache
