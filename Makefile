# waferbot on a machine without ROS 2: everything goes into .venv, build and install in this folder.
# With ROS 2 Jazzy installed, use rosdep and colcon instead (see README.md).

SHELL := /bin/bash
PYTHON ?= python3
VENV := $(CURDIR)/.venv
MESSAGES := $(shell find src/waferbot_msgs -type f)
PACKAGE_FILES := $(wildcard src/*/package.xml src/*/setup.py src/*/setup.cfg)
SHARED_FILES := $(shell find src -path '*/config/*' -o -path '*/launch/*' -o -path '*/urdf/*')

# A ROS 2 installation that happens to be sourced must not be mixed with the wheels.
CLEAN_ENVIRONMENT := env -u AMENT_PREFIX_PATH -u CMAKE_PREFIX_PATH -u COLCON_PREFIX_PATH -u PYTHONPATH -u LD_LIBRARY_PATH
RUN := ./waferbot --exec
SIDE_BY_SIDE := --numprocesses auto --dist loadfile

.PHONY: help build demo test test-fast lint bench bench-diagnosis bench-fuzz clean

help:
	@echo 'make demo       set up, run the twin over ROS 2, diagnose logs of a machine'
	@echo 'make test       linters, type checker and all tests (what CI runs)'
	@echo 'make test-fast  linters and the tests that need no ROS processes (2 minutes; more the first time)'
	@echo 'make bench      measure speed: engines beside the raw exchange of messages, plant beside MuJoCo and pinocchio'
	@echo 'make bench-diagnosis  blind tests of the diagnosis; OPTIONS=--help says how to do a part of them'
	@echo 'make bench-fuzz  5000 damaged inputs of every kind, none of which may bring a traceback'
	@echo 'make build      only set up: .venv with ROS 2 Jazzy from PyPI, then colcon build'
	@echo 'make clean      remove everything that the above made'

build: install/.built

$(VENV)/.installed: $(wildcard requirements/*.txt)
	@echo 'Making .venv with ROS 2 Jazzy from PyPI (about a minute) ...'
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  -r requirements/ros-jazzy.txt -r requirements/runtime.txt -r requirements/development.txt
	touch $@

install/.built: $(VENV)/.installed $(MESSAGES) $(PACKAGE_FILES) $(SHARED_FILES)
	@# links to files that are no more would stop colcon
	@find build install -xtype l -delete 2>/dev/null || true
	$(CLEAN_ENVIRONMENT) PATH="$(VENV)/bin:$$PATH" AMENT_PREFIX_PATH=$(VENV) CMAKE_PREFIX_PATH=$(VENV) \
	  $(VENV)/bin/colcon build --merge-install --symlink-install --base-paths src \
	  --event-handlers status- 2> >(grep -v "doesn't contain any 'local_setup" >&2)
	touch $@

demo: build
	./waferbot demo

lint: build
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(RUN) mypy

# Side by side on all cores, but for those that ask for the wall clock or a certain ROS domain.
test: lint
	$(RUN) pytest $(SIDE_BY_SIDE) src
	$(RUN) pytest $(SIDE_BY_SIDE) -m 'not alone' tests
	$(RUN) pytest -m alone tests

test-fast: lint
	$(RUN) pytest -m 'not slow' $(SIDE_BY_SIDE) src
	$(RUN) pytest -m 'not slow' $(SIDE_BY_SIDE) tests

bench: build
	$(RUN) python tests/bench/bench_engines.py
	$(RUN) python tests/bench/bench_plant.py

bench-diagnosis: build
	$(RUN) python tests/bench/bench_diagnosis.py $(OPTIONS)

bench-fuzz: build
	$(RUN) python tests/bench/bench_fuzz.py $(OPTIONS)

clean:
	rm -rf .venv build install log runs bench-results .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
