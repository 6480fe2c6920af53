# Everything a fresh Debian machine with Python 3.11 needs: `make demo` and `make test` set up first.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo
# A new seed gives new scenes, in a folder of their own.
SEED ?= 2026
JUDGE := judge-$(SEED)
# Tests run in two processes; each needs up to 4 GB. `make test TEST_PROCESSES=0` runs them in one.
TEST_PROCESSES ?= 2
# Each process runs a stretch of the tests in their order, so that few fixtures are made twice.
PYTEST := $(BIN)/pytest --numprocesses $(TEST_PROCESSES) --dist worksteal
# One process, which runs two commands at a time and has one seed and one table of results.
FUZZ := NIGHT_FUZZ_SEED=$${NIGHT_FUZZ_SEED:-$$(date +%s)} $(BIN)/pytest tests/trust/fuzz

.PHONY: setup demo judge docs test test-short test-long test-thorough fuzz lint clean

setup: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt .ci/system_libraries
	PYTHON=$(PYTHON) bash .ci/system_libraries
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[dev]"
	touch $@

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What to run before a commit. The types are checked beside the tests, which wait for each other at times.
test: setup
	$(MAKE) --no-print-directory --jobs 2 lint test-short

test-short: setup
	$(PYTEST) -m "not long and not thorough"

# What takes seconds each, and what a change can break all the same.
test-long: setup
	$(PYTEST) -m "long and not thorough"

# Damage by the thousand, kills by the hundred, convergence studies: CI has no time for them.
test-thorough: setup
	$(PYTEST) -m thorough --ignore tests/trust/fuzz
	NIGHT_FUZZ_INPUTS=200 $(FUZZ)

# The campaign of docs/reference/security.md: about 9,000 damaged files and 280 kills; its table is in fuzz.md.
fuzz: setup
	NIGHT_FUZZ_INPUTS=500 NIGHT_FUZZ_KILLS=40 NIGHT_FUZZ_TABLE=fuzz.md $(FUZZ)

# Scenes, renders and training go on where an interrupted demo stopped; `make clean` starts over.
# First a prediction by the network that comes with NIGHT, of a scene that is made and rendered for it, with its
# transient. A training needs phasors only.
demo: setup
	$(BIN)/night-gen scenes $(DEMO)/first --preset demo --count 1 --seed 7
	$(BIN)/night-render $(DEMO)/first
	$(BIN)/night-eval predict night-40x30 $(DEMO)/first/renders/000000/itof.exr --out $(DEMO)/first_prediction
	$(BIN)/night-gen scenes $(DEMO)/dataset --preset demo
	$(BIN)/night-render $(DEMO)/dataset --product itof --workers 2
	$(BIN)/night-train $(DEMO)/dataset --out $(DEMO)/run --preset demo $(if $(wildcard $(DEMO)/run/run.json),--resume)
	$(BIN)/night-eval $(DEMO)/run $(DEMO)/dataset --split test --out $(DEMO)/report

# night-80x60, judged on 269 new scenes of a seed of your own: `make judge SEED=31415` (ours: docs/science/accuracy.md).
judge: setup
	$(BIN)/night-gen scenes $(JUDGE) --preset judge --seed $(SEED)
	$(BIN)/night-render $(JUDGE) --product itof --resolution 80x60 --workers 2
	$(BIN)/night-eval night-80x60 $(JUDGE) --out $(JUDGE)_report

# The documentation as a site, in site/; needs no network after the set-up.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(DEMO) site
