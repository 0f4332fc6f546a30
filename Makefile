# Every target sets itself up: all that is needed is Python 3.11 or newer, make and git.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKERS ?= 2

.PHONY: demo test test-oldest lint types bench studies docs clean

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $(READY)

demo: $(READY)
	rm -rf demo-output
	$(BIN)/planeopt demo -o demo-output --jobs $(WORKERS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/pyright

# A file's tests stay together: what they share (a calibration, a page, a report) is made once and not in each worker.
# Threads within the workers would only stand in each other's way; so they would in a study's.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

test: lint types
	$(ONE_THREAD) $(BIN)/pytest -n $(WORKERS) --dist loadfile

# The other end of what pyproject.toml allows: the oldest versions of everything, OpenCV 4.10 among them, and the tests
# that reach it. Wheels of all of them exist for Python 3.11 and 3.12. What old libraries deprecate of each other is theirs.
OLDEST_PYTHON ?= $(shell for python in python3.11 python3.12; do $$python -V >/dev/null 2>&1 && echo $$python && break; done)
OLDEST := .venv-oldest
OLDEST_READY := $(OLDEST)/.ready
OLDEST_TESTS ?= $(wildcard $(addprefix tests/test_,batch.py board*.py calibration*.py cli*.py detection*.py formats*.py \
	rig_camera.py simulation*.py spot*.py))

$(OLDEST_READY): pyproject.toml tests/oldest.py
	$(or $(OLDEST_PYTHON),$(PYTHON)) -m venv $(OLDEST)
	$(OLDEST)/bin/python tests/oldest.py > $(OLDEST)/constraints.txt
	$(OLDEST)/bin/python -m pip install --quiet --only-binary :all: --constraint $(OLDEST)/constraints.txt --editable '.[test]'
	touch $(OLDEST_READY)

test-oldest: $(OLDEST_READY)
	$(OLDEST)/bin/pytest -n $(WORKERS) -W ignore::DeprecationWarning $(OLDEST_TESTS)

bench: $(READY)
	$(ONE_THREAD) $(BIN)/pytest benchmarks -p no:cacheprovider --write-tables

studies: $(READY)
	$(ONE_THREAD) $(BIN)/python -m studies --jobs $(WORKERS)

# A page for each room but the command line, whose documentation is its --help; the rooms' pages hold their public names.
ROOMS := $(sort $(filter-out __% cli,$(basename $(notdir $(wildcard src/planeopt/*.py))) \
	$(notdir $(patsubst %/__init__.py,%,$(wildcard src/planeopt/*/__init__.py)))))

docs: $(READY)
	rm -rf docs/api
	$(BIN)/python -W error -m pdoc --docformat numpy --math -t docs/theme -o docs/api \
		planeopt $(ROOMS:%=planeopt.%) '!planeopt[.].*[.].*'

clean:
	rm -rf $(VENV) $(OLDEST) .venv-peers demo-output docs/api build dist .pytest_cache .ruff_cache .hypothesis .benchmarks
