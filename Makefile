# `make demo` does everything from nothing: environment, install, a sample site, the flow, the pictures.
# `make missions` lets a simulated robot drive two sample missions; `make test` runs the tests. All install what they need
# into $(VENV) first.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO ?= demo

.DELETE_ON_ERROR:
.PHONY: demo missions test lint install lock policy fixtures golden docs clean

install: $(VENV)/.installed

# Torch is asked for by its exact version first: an open range would fetch gigabytes of CUDA libraries.
$(VENV)/.installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet "$$(grep '^torch==' requirements.lock)"
	$(BIN)/pip install --quiet -r requirements.lock
	$(BIN)/pip install --quiet --no-deps --editable .
	$(BIN)/python -m compileall -q hrt_cli commands
	touch $@

demo: $(VENV)/.installed
	@PATH="$(abspath $(BIN)):$$PATH" DEMO="$(DEMO)" sh pipelines/demo.sh

# Two missions of a simulated robot from survey to figures: hot spots on burnt ground, and the coral of a reef.
missions: $(VENV)/.installed
	@for mission in wildfire reef; do PATH="$(abspath $(BIN)):$$PATH" sh pipelines/missions.sh $$mission || exit 1; done

test: $(VENV)/.installed
	$(BIN)/python -m pytest -n 2

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy hrt_cli commands

# Pin what a fresh environment resolves to today.
lock:
	rm -rf $(VENV)-lock && $(PYTHON) -m venv $(VENV)-lock
	$(VENV)-lock/bin/pip install --quiet --upgrade pip
	$(VENV)-lock/bin/pip install --quiet torch==2.13.0
	$(VENV)-lock/bin/pip install --quiet --editable ".[dev]"
	$(VENV)-lock/bin/pip list --format=freeze | grep -v -i -E '^(hrt|pip|setuptools|wheel)==' | sed 's/+cpu$$//' > requirements.lock
	rm -rf $(VENV)-lock

# The policies that ship with the package: the default training, the same bytes from the same seed.
policy: $(VENV)/.installed
	$(BIN)/hrt train-plan -o hrt_cli/planning/default_policy_network.npz --overwrite
	$(BIN)/hrt train-plan --features manjanna24 -o hrt_cli/planning/default_policy_manjanna24.npz --overwrite

# The sample sites of fixtures/, and the figures that the flow reaches on them.
fixtures: $(VENV)/.installed
	for scene in meadow wildfire reef; do \
	  $(BIN)/hrt synth fixtures/$$scene --scene $$scene --size 32 --pixel 0.1 --seed 1 --overwrite; \
	done

golden: $(VENV)/.installed
	$(BIN)/python tests/flow/golden.py --write

# The reference of the commands, docs/cli/, as their help tells it.
docs: $(VENV)/.installed
	$(BIN)/python tests/shell/reference.py --write

clean:
	rm -rf $(DEMO) missions build dist *.egg-info
