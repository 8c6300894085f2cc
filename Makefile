# Python 3.11 or later and make are all this needs. `make help` lists the targets.
#
# 1. The environment is made once: a stamp in it says what is installed, pyproject.toml makes it stale.
# 2. Tests and checks run with the releases that constraints.txt names, the same on every machine; users get the package's own
#    ranges.
# 3. `demo` installs the package and what draws; what tests and checks need is fetched when they are asked for.

PYTHON ?= python3
VENV   ?= .venv
JOBS   ?= 2
ARGS   ?=
# Examples per property in `make test-long`, and the seed they are drawn from: `make test-long SEED=N` draws them again.
ACES_EXAMPLES ?= 2000
SEED   ?= $(shell date +%s)
# How often `make test-steady` runs the tests.
RUNS   ?= 20

# Tests start our programs some hundred times: without their bytecode each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE
# What is installed is tested, whatever else the caller's shell puts on the path or says to pytest.
unexport PYTHONPATH PYTEST_ADDOPTS HYPOTHESIS_PROFILE

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# An index that fails for a moment looks like versions that do not go together: what is installed is asked for once more.
TWICE = $(1) || { echo "once more, in 10 s" >&2; sleep 10; $(1); }

.DEFAULT_GOAL := help
.PHONY: help venv demo prove badges test test-slow test-real test-leaks mutants test-oracles test-lerobot test-studio test-urdf planted test-long test-steady constraints test-socketcan docs first-hour soak stops teleoperation budget release compiled test-compiled check lint types mypy pyright pristine format bench bench-framings guess-score golden clean fleet

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 12

venv: $(VENV)/.dev ## make .venv with everything that tests and checks need

$(VENV)/.python:
	@command -v $(PYTHON) >/dev/null || { echo "no '$(PYTHON)' found; name one: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "aces-bus needs Python 3.11 or later; '$(PYTHON)' is $$($(PYTHON) -V 2>&1). Name one: make PYTHON=python3.12" >&2; exit 1; }
	@echo "making $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.run: $(VENV)/.python pyproject.toml
	@echo "installing aces-bus into $(VENV) (once)"
	@$(call TWICE,$(PIP) --editable .)
	@touch $@

$(VENV)/.demo: $(VENV)/.run
	@echo "installing matplotlib into $(VENV) (once)"
	@$(PIP) --editable '.[plot]' && touch $@ || echo "not installed: the demo draws in the terminal alone" >&2

$(VENV)/.dev: $(VENV)/.python pyproject.toml constraints.txt
	@echo "installing aces-bus and its development tools into $(VENV) (once)"
	@$(call TWICE,$(PIP) --constraint constraints.txt --editable '.[dev]')
	@touch $@ $(VENV)/.run

$(VENV)/.docs: $(VENV)/.dev
	@echo "installing Sphinx and its theme into $(VENV) (once)"
	@$(call TWICE,$(PIP) --constraint constraints.txt --editable '.[docs]')
	@touch $@

$(VENV)/.oracles: $(VENV)/.dev
	@echo "installing the programs that tests/oracles holds ours against into $(VENV) (once)"
	@$(call TWICE,$(PIP) --constraint constraints.txt --editable '.[oracles]')
	@# Beside the others: it has a package `tests` that would take the place of ours.
	@$(call TWICE,$(PIP) --no-deps --upgrade --target $(VENV)/pyvesc 'pyvesc-fix==1.0.3')
	@# By itself: it asks for another construct, and runs with ours.
	@$(call TWICE,$(PIP) --no-deps 'crsf-parser==0.3.2')
	@touch $@

$(VENV)/.bench: $(VENV)/.python pyproject.toml
	@echo "installing aces-bus and the libraries it is measured against into $(VENV) (once)"
	@$(PIP) --editable '.[bench]'
	@touch $@ $(VENV)/.run

# `sed` shows the first lines and lets the rest run, so that the summary speaks of the whole file.
FIRST := | sed -n '1,14p'

demo: $(VENV)/.demo ## decode the captures in examples/captures, draw a message; a simulated robot moves, drawn
	$(BIN)/aces decode examples/captures/robotis_session.dxconf.txt -p robotis --direction both $(FIRST)
	@echo
	$(BIN)/aces decode examples/captures/hubo2plus.log -p hubo $(FIRST)
	@echo
	$(BIN)/aces decode examples/captures/hubo2plus.log -p hubo --message Status --format jsonl $(FIRST)
	@echo
	$(BIN)/aces decode examples/captures/adc.bin -p minihubo_adc $(FIRST)
	@echo
	$(BIN)/aces protocols hubo Current
	@echo
	$(BIN)/aces demo

PYTEST := $(BIN)/python -m pytest -n $(JOBS) --benchmark-disable -q

test: $(VENV)/.dev ## run the tests but the slow ones (some three minutes on two cores); ARGS="-k name" to choose
	$(PYTEST) -m "not slow" $(ARGS)

test-slow: $(VENV)/.dev ## the other tests: programs beside one another, long simulated runs, three of four cases alike (tests/slow.toml)
	$(PYTEST) -m slow $(ARGS)

test-leaks: export ACES_COLLECT := 1
test-leaks: $(VENV)/.dev ## the quick tests, each of which fails if it leaves a socket, a file or a thread behind (minutes)
	$(PYTEST) -m "not slow" $(ARGS)

# How long the whole robot runs in real time, in seconds, and how many ends of each kind there are.
test-real: export ACES_REAL_SECONDS ?= 20
test-real: export ACES_STOPS ?= 3
test-real: $(VENV)/.dev ## stops and a whole robot in real time: programs, signals, threads, sockets (a minute)
	HYPOTHESIS_PROFILE=long $(BIN)/python -m pytest -q -m long tests/tools/test_stops.py tests/robot/test_real_time.py $(ARGS)

mutants: $(VENV)/.dev ## plant faults and name those that no test notices; ARGS="--since main", ARGS="--area stops --count 60"
	$(BIN)/python -m tests.mutants $(ARGS)

test-oracles: $(VENV)/.oracles ## vendors' own programs and peer libraries against our specs and twins
	$(PYTEST) tests/oracles tests/ros2 tests/tools/test_ros2.py tests/fleet/test_fleet_stores.py $(ARGS)

# LeRobot asks for far more than its bus class imports: that alone is installed, with PyTorch (TORCH names another build of it).
LEROBOT := $(VENV)-lerobot
TORCH ?= torch torchvision
$(LEROBOT)/.python: pyproject.toml
	$(PYTHON) -m venv $(LEROBOT)
	$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps 'lerobot==0.4.4'
	$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check $(TORCH) accelerate av datasets deepdiff diffusers \
		draccus dynamixel-sdk einops feetech-servo-sdk gymnasium imageio jsonlines opencv-python-headless 'rerun-sdk<0.27' \
		termcolor tqdm --editable '.[testing]' --editable tools/lerobot_robot_aces
	@touch $@

test-lerobot: $(LEROBOT)/.python ## LeRobot's bus classes with our twins, its programs with our robots (2 GB with a PyTorch without CUDA)
	$(LEROBOT)/bin/python -m pytest tests/oracles/test_lerobot.py tests/oracles/test_lerobot_plugin.py --override-ini 'addopts=--import-mode=importlib' $(ARGS)

# Chromium is the system's: a package of its distribution.
test-studio: export ACES_STUDIO := 1
test-studio: $(VENV)/.oracles ## the studio in a real browser (Debian: chromium, chromium-driver); ACES_PICTURES=folder keeps pictures
	$(BIN)/python -m pytest -n 0 --benchmark-disable -q -rs tests/lab/studio $(ARGS)

$(VENV)/.urdf: $(VENV)/.dev
	@echo "installing pinocchio and public models of robots into $(VENV) (once, 170 MB)"
	@$(call TWICE,$(PIP) --editable '.[urdf-oracle]')
	@touch $@

test-urdf: $(VENV)/.urdf ## kinematics and torques against pinocchio's, on 69 public models of robots
	$(PYTEST) tests/oracles/test_urdf.py $(ARGS)

planted: $(VENV)/.oracles ## which of 30 bugs, planted in copies of four packages, a test finds with --aces-faults all (a quarter of an hour)
	$(BIN)/python -m tests.oracles.planted $(ARGS)

test-long: $(VENV)/.dev ## run the tests with ACES_EXAMPLES (2000) examples per property, drawn anew; SEED=N draws them again
	HYPOTHESIS_PROFILE=long ACES_EXAMPLES=$(ACES_EXAMPLES) $(PYTEST) --hypothesis-seed=$(SEED) $(ARGS)

test-steady: $(VENV)/.dev ## run the tests RUNS (20) times under other hash seeds and gc thresholds, every third beside a busy machine
	$(BIN)/python tests/steady.py --runs $(RUNS) --jobs $(JOBS) -- $(ARGS)

first-hour: ## what the first three pages say, typed in a fresh environment, and compared (minutes: it installs)
	PYTHON=$(PYTHON) tests/tools/first_hour.sh

docs: $(VENV)/.docs ## the documentation site, in build/site/html; a warning is an error
	$(BIN)/python docs/build_site.py

test-socketcan: $(VENV)/.dev ## SocketCAN with a real kernel under QEMU (a minute; needs Debian and qemu-system-x86)
	$(BIN)/python tests/socketcan/run.py $(ARGS)

soak: $(VENV)/.dev ## a full 1 Mbit/s bus through a live scanner for a minute; ARGS="--seconds 600" for longer
	$(BIN)/python -m tests.bench.soak $(ARGS)

stops: $(VENV)/.dev ## ends of `aces device` against `aces sim`, in real time; ARGS="--runs 50" for a release
	$(BIN)/python -m tests.bench.stops $(ARGS)

teleoperation: $(VENV)/.dev ## SO-101, leader to follower over two pseudo-terminals in real time: latency and CPU; ARGS="--seconds 60"
	$(BIN)/python -m tests.bench.teleoperation $(ARGS)

budget: $(VENV)/.dev ## response times against the virtual bus: SETS (1000) drawn message sets, 10 s over 20 phases each, and an hour (ten minutes of processor time)
	HYPOTHESIS_PROFILE=long ACES_SETS=$(or $(SETS),1000) $(PYTEST) -vv -m long tests/budget $(ARGS)

# Inputs of the test in which workers die; `make test-slow` takes fewer.
fleet: export ACES_FLEET_INPUTS ?= 200
fleet: $(VENV)/.oracles ## fleets: workers that die among 200 recordings, stores, and the figures of docs/fleets.md (minutes)
	$(BIN)/python -m pytest tests/fleet --benchmark-disable -q $(ARGS)
	$(BIN)/python -m tests.fleet.measure

release: $(VENV)/.dev ## sdist, wheels and an SBOM in dist/, built twice, the same bytes; nothing is uploaded (minutes)
	@$(PIP) --editable ".[release]"
	$(BIN)/python -m tests.release --compiled

compiled: $(VENV)/.dev ## the same sources, virtual time's modules compiled by mypyc, in build/compiled (minutes; needs gcc)
	@$(BIN)/python -c 'import setuptools' 2>/dev/null || $(PIP) setuptools
	$(BIN)/python -m tests.compiled

test-compiled: compiled ## the tests in the compiled build; ARGS="tests/robot" to choose
	cd build/compiled && $(abspath $(BIN))/python -m pytest -n $(JOBS) --benchmark-disable -q $(or $(ARGS),tests)

check: lint types pristine ## ruff, mypy, pyright and the pristine check

lint: $(VENV)/.dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: mypy pyright

mypy: $(VENV)/.dev
	$(BIN)/mypy

pyright: $(VENV)/.dev
	$(BIN)/pyright --project . --warnings --pythonpath $(BIN)/python
	PATH=$(abspath $(BIN)):$$PATH $(BIN)/python tests/typed_pages.py $(BIN)/python

pristine: $(VENV)/.dev
	$(BIN)/python tests/pristine.py

format: $(VENV)/.dev ## let ruff rewrite the sources
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: $(VENV)/.bench ## measure beside the peers, on this machine
	$(BIN)/python -m tests.bench live $(ARGS)

bench-framings: $(VENV)/.bench ## UBX, MAVLink and NMEA beside their usual libraries
	$(BIN)/python -m tests.bench.framings

guess-score: $(VENV)/.dev ## precision and recall of `aces spec guess` where the spec is known, beside READ (some minutes)
	$(BIN)/python -m tests.bench.guess $(ARGS)

prove: $(VENV)/.dev ## prove all shipped protocols and write their badges (under ten minutes on two cores)
	$(BIN)/python -m aces_lab.prove.shipped $(ARGS)

badges: $(VENV)/.oracles ## run what badges stand for, and write them: all of the catalogue (a quarter of an hour), or ARGS="ld06"
	$(BIN)/aces spec badge --save $(or $(ARGS),$(shell $(BIN)/python -c "import aces_bus; print(*aces_bus.list_protocols())"))
	$(BIN)/python docs/catalogue.py

golden: $(VENV)/.dev ## write the golden files anew; read the diff before you commit it
	$(BIN)/python -m pytest tests -q --update-golden $(ARGS)

constraints: ## pin anew what tests and checks run with, in an environment of its own
	rm -rf $(VENV)-pinned
	$(PYTHON) -m venv $(VENV)-pinned
	$(VENV)-pinned/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,oracles,docs]'
	sed -n '/^#/p' constraints.txt > $(VENV)-pinned/constraints.txt
	$(VENV)-pinned/bin/python -m pip freeze --exclude-editable >> $(VENV)-pinned/constraints.txt
	mv $(VENV)-pinned/constraints.txt constraints.txt
	rm -rf $(VENV)-pinned

clean: ## remove what was made, .venv included
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
