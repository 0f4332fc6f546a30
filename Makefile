# Every target sets itself up: all that is needed is Python 3.11 or newer, make and git.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKERS ?= 2

.PHONY: demo test lint types bench studies docs clean

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $(READY)

demo: $(READY)
	rm -rf demo-output
	$(BIN)/planeopt demo -o demo-output

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/pyright

test: lint types
	$(BIN)/pytest -n $(WORKERS)

bench: $(READY)
	$(BIN)/pytest benchmarks -p no:cacheprovider

# The work is spread over processes: threads within each would only stand in each other's way.
studies: $(READY)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies --jobs $(WORKERS)

# A page for each room but the command line, whose documentation is its --help; the rooms' pages hold their public names.
ROOMS := $(sort $(filter-out __% cli,$(basename $(notdir $(wildcard src/planeopt/*.py))) \
	$(notdir $(patsubst %/__init__.py,%,$(wildcard src/planeopt/*/__init__.py)))))

docs: $(READY)
	rm -rf docs/api
	$(BIN)/python -W error -m pdoc --docformat numpy --math -t docs/theme -o docs/api \
		planeopt $(ROOMS:%=planeopt.%) '!planeopt[.].*[.].*'

clean:
	rm -rf $(VENV) demo-output docs/api build dist .pytest_cache .ruff_cache .hypothesis .benchmarks
