# make run and make test do all the set-up; they need Python 3.11+, make and git, nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
EVALUATIONS ?= 3000

export MLFLOW_DISABLE_TELEMETRY := true
export DO_NOT_TRACK := true
# Packages are installed without what Python compiles of them, which is kept when they are first imported.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: install install-all run view test test-thorough quick lint docs ui notebooks figures paper-experiment clean

# uv where there is one, else pip; the same pins.
UV := $(shell command -v uv 2>/dev/null)
MAKE_VENV := $(if $(UV),$(UV) venv --quiet --seed --allow-existing --python $(PYTHON) $(VENV),$(PYTHON) -m venv $(VENV))
# Without setuptools' warning about every editable install.
INSTALL := PYTHONWARNINGS=ignore $(if $(UV),$(UV) pip install --quiet --python $(BIN)/python,\
  $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check) --constraint constraints.txt --editable
EVERYTHING := '.[all,nevergrad,postgres,suite]'
TIMED = began=$$(date +%s) && $(1) && echo "$(2) took $$(($$(date +%s) - began)) s"

install: $(VENV)/installed  ## what the main job needs, compiled
install-all: $(VENV)/installed-all  ## what all commands and the tests need; nothing more is compiled

# Reinstalled whenever what is pinned or declared changes.
$(VENV)/made: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "error: lmd needs Python 3.11 or newer; set PYTHON=python3.x")'
	@$(MAKE_VENV)
	@touch $@

# A small run compiles what the main job calls. Beside it Python compiles the modules of tracking.
FIRST := budget.evaluations=60 tracking=none threads=1 hydra.run.dir=$(VENV)/first
TRACKED := mlflow.tracking.client, mlflow.store.tracking.sqlalchemy_store, sqlalchemy.dialects.sqlite
COMPILE = rm -rf $(VENV)/first && { $(BIN)/python -c 'import $(TRACKED)' & \
  $(BIN)/python -m pipelines.optimise $(FIRST) > /dev/null && wait; }

$(VENV)/installed: $(VENV)/made
	@echo "installing what the main job needs, with $(if $(UV),uv,pip)"
	@$(call TIMED,$(INSTALL) '.[pipelines]',installing)
	@$(call TIMED,$(COMPILE),compiling)
	@touch $@

$(VENV)/installed-all: $(VENV)/made
	@echo "installing what all commands and the tests need, with $(if $(UV),uv,pip)"
	@$(if $(UV),,$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt 'pip>=25.1')
	@$(call TIMED,$(INSTALL) $(EVERYTHING) --group dev,installing)
	@# Once, before many processes would do it at the same time: what Python compiles of all packages, and the main job.
	@$(call TIMED,PYTHONPATH=.:tests $(BIN)/python -c 'import support.warm',compiling)
	@touch $@

run: install  ## the main job on the paper's room at a small budget
	$(BIN)/python -m pipelines.optimise budget.evaluations=$(EVALUATIONS)

view: install-all  ## the planner in the browser, for experiment=lab
	-$(BIN)/python -m pipelines.view experiment=lab

# Files in their order: those with few tests, which take longest, else come last, one after the other.
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test: install-all  ## the test suite, without thorough tests
	$(PYTEST)

test-thorough: install-all  ## all tests: real services, kills, and property tests with fifteen times as many examples
	LMD_THOROUGH=all LMD_EXAMPLES=3 $(PYTEST)

quick: install-all  ## the tests that are not slow, for while you work
	$(PYTEST) -m 'not slow'

lint: install-all  ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: install-all  ## the documentation as HTML in build/docs; a broken link or reference fails
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

ui: install  ## browse the runs at http://127.0.0.1:5000
	-$(BIN)/python -m pipelines.runs
	@# Without the four processes of 240 MB that wait for mlflow's own jobs, and with one that answers.
	MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false $(BIN)/mlflow ui \
	  --backend-store-uri sqlite:///outputs/mlflow.db --host 127.0.0.1 --port 5000 --workers 1

notebooks: install-all  ## run the notebooks and keep what they show
	$(BIN)/python notebooks/store.py

figures: install-all  ## the picture in the README
	$(BIN)/python benchmarks/front_page.py

EXPERIMENT := outputs/paper_experiment
WITH_PDF := experiment=paper_experiment pdf=samples pdf.path=$(EXPERIMENT)/pdf/pdf.csv

paper-experiment: install  ## the paper's experiment, simulated: PDF from a recording, optimise, fly
	$(BIN)/python -m pipelines.estimate_pdf simulate={pitch_std: 0.0} hydra.run.dir=$(EXPERIMENT)/pdf
	rm -rf $(EXPERIMENT)/optimised
	$(BIN)/python -m pipelines.optimise $(WITH_PDF) budget.evaluations=$(EVALUATIONS) hydra.run.dir=$(EXPERIMENT)/optimised
	$(BIN)/python -m pipelines.evaluate "studies=[observe]" $(WITH_PDF) "deployments=[file,uniform,random]" \
	  deployment.path=$(EXPERIMENT)/optimised/landmarks.csv hydra.run.dir=$(EXPERIMENT)/observed

clean:  ## remove the environment and caches, keep outputs
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find lmd tests -name '*.nb[ic]*' -delete
