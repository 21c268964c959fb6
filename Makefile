# waferbot on a machine without ROS 2: everything goes into .venv, build and install in this folder.
# With ROS 2 Jazzy installed, use rosdep and colcon instead (see README.md).

SHELL := /bin/bash
PYTHON ?= python3
# Make splits names at spaces: files are named relative to this folder.
VENV := .venv
MESSAGES := $(shell find src/waferbot_msgs -type f)
PACKAGE_FILES := $(wildcard src/*/package.xml src/*/setup.py src/*/setup.cfg)
LAUNCH_FILES := $(wildcard src/*/launch/*)
REQUIREMENTS := -r requirements/ros-jazzy.txt -r requirements/runtime.txt -r requirements/development.txt
# Exact versions that were tried, where there are some for this Python; the lower bounds alone elsewhere.
LOCK = requirements/lock-python$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])').txt

RUN := ./waferbot --exec
# As many workers as conftest.py says, and files in its order, long ones first; xdist's own is by the number
# of tests.
SIDE_BY_SIDE := --numprocesses auto --dist loadfile --no-loadscope-reorder

.PHONY: help build demo test test-fast lint bench bench-diagnosis bench-endurance bench-fuzz docs audit lock clean

help:
	@echo 'make demo       set up, run the twin over ROS 2, diagnose logs of a machine'
	@echo 'make test       linters, type checker and all tests (what CI runs)'
	@echo 'make test-fast  linters and the tests that need no ROS processes (2 minutes; more the first time)'
	@echo 'make bench      measure speed: engines beside the raw exchange of messages, plant beside MuJoCo and pinocchio'
	@echo 'make bench-diagnosis  blind tests of the diagnosis; OPTIONS=--help says how to do a part of them'
	@echo 'make bench-endurance  starts, lossy controllers, killed nodes, over and over (an hour)'
	@echo 'make bench-fuzz  5000 damaged inputs of every kind, none of which may bring a traceback'
	@echo 'make build      only set up: .venv with ROS 2 Jazzy from PyPI, then colcon build'
	@echo 'make docs       the documentation as a site in build/docs; broken links are errors'
	@echo 'make audit      known vulnerabilities of the locked versions (needs the network)'
	@echo 'make lock       newest versions within the bounds, as the lock of this Python'
	@echo 'make clean      remove everything that the above made'

build: install/.built

$(VENV)/.installed: $(wildcard requirements/*.txt)
	@echo 'Making .venv with ROS 2 Jazzy from PyPI (about a minute) ...'
	$(PYTHON) -m venv $(VENV)
	@test -e $(LOCK) || echo 'There is no $(LOCK): the newest versions within the bounds are taken.'
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check $(REQUIREMENTS) \
	  $(if $(wildcard $(LOCK)),--constraint $(LOCK))
	touch $@

install/.built: $(VENV)/.installed $(MESSAGES) $(PACKAGE_FILES) $(LAUNCH_FILES)
	.ci/colcon-build
	touch $@

demo: build
	./waferbot demo

lint: build
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(RUN) mypy

# Side by side on all cores, but for those that ask for the wall clock or a certain ROS domain.
test: lint
	$(RUN) pytest $(SIDE_BY_SIDE) -m 'not alone' src tests
	$(RUN) pytest -m alone tests

test-fast: lint
	$(RUN) pytest -m 'not slow' $(SIDE_BY_SIDE) src tests

bench: build
	$(RUN) python tests/bench/bench_engines.py
	$(RUN) python tests/bench/bench_plant.py

bench-diagnosis: build
	$(RUN) python tests/bench/bench_diagnosis.py $(OPTIONS)

bench-endurance: build
	$(RUN) python tests/bench/bench_endurance.py $(OPTIONS)

bench-fuzz: build
	$(RUN) python tests/bench/bench_fuzz.py $(OPTIONS)

docs: $(VENV)/.docs
	$(VENV)/bin/python -m mkdocs build --strict --site-dir build/docs

$(VENV)/.docs: $(VENV)/.installed requirements/docs.txt
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check -r requirements/docs.txt
	touch $@

# Known vulnerabilities of the versions in the lock; asks the database of PyPI, so it needs the network. What
# the database does not know is an error, too.
audit:
	@test -e $(LOCK) || { echo 'There is no $(LOCK); run make lock first.' >&2; exit 1; }
	$(PYTHON) -m venv build/audit
	build/audit/bin/python -m pip install --quiet --disable-pip-version-check pip-audit
	build/audit/bin/python -m pip_audit --strict --disable-pip --no-deps --requirement $(LOCK) $(OPTIONS)

# The newest versions within the bounds, to be committed when `make test` has passed with them.
lock:
	$(PYTHON) .ci/lock $(REQUIREMENTS) > $(LOCK).new
	mv $(LOCK).new $(LOCK)

clean:
	rm -rf .venv build install log runs bench-results .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
