# Every target prepares what it needs: a fresh clone runs any of them as the first command.
.DEFAULT_GOAL := help
SHELL := /bin/bash
RUN := ros_ws/run.sh
SCRIPTS := bags/*.py docs/*.py examples/*.py ros_ws/*.py
PYTHON_SOURCES := src tests benchmarks $(SCRIPTS)
CORES := src/dc_motor_sim/dc_motor_sim src/gray_box_observer/gray_box_observer

# make demo
DURATION ?= 60
MOTOR ?= thesis
EXCITATION ?=
SEED ?= 1
TORQUE_NOISE ?= 0.01
DASHBOARD ?= 1
BAG ?=
PARAMS ?=
RATE ?= 1
DEMO_ARGS ?=
# make test
ARGS ?=
WORKERS ?= 4
# make bench
NAME ?=
QUICK ?=

.PHONY: help setup demo test test-fast lint format physics docs bench clean distclean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## make .venv where needed and build ros_ws/install (ROS=auto|distribution|wheels PYTHON=)
	@ROS='$(ROS)' PYTHON='$(PYTHON)' ros_ws/setup.sh

demo: setup  ## identify a simulated motor live (DURATION= MOTOR=thesis|geared EXCITATION= SEED= TORQUE_NOISE= DASHBOARD=0), or a bag (BAG= RATE= PARAMS=)
	@$(RUN) python ros_ws/demo.py --duration '$(DURATION)' --motor '$(MOTOR)' --seed '$(SEED)' \
		--torque-noise '$(TORQUE_NOISE)' $(if $(EXCITATION),--excitation '$(EXCITATION)') \
		$(if $(filter 0 no false,$(DASHBOARD)),--no-dashboard) $(if $(BAG),--bag '$(BAG)' --rate '$(RATE)') \
		$(if $(PARAMS),--params '$(PARAMS)') $(DEMO_ARGS)

# More processes than cores: tests of nodes mostly wait. `load`: the other ways of dealing tests out wait for ever once a process of tests has ended.
# Few tests at a time, or one process is left alone at the end with a hundred tests of nodes.
test: setup  ## run every test (ARGS='-k pairing' WORKERS=2)
	$(RUN) python -m pytest -n $(WORKERS) --dist load --maxschedchunk 16 $(ARGS)

test-fast: setup  ## tests that start no node and no process and take no time (ARGS='-k pairing')
	$(RUN) python -m pytest -n 2 --dist load -m 'not live and not system and not slow' $(ARGS)

lint: setup  ## ruff, its formatter and strict mypy over cores and scripts
	$(RUN) python -m ruff check $(wildcard $(PYTHON_SOURCES))
	$(RUN) python -m ruff format --check $(wildcard $(PYTHON_SOURCES))
	$(RUN) python -m mypy $(CORES) $(wildcard $(SCRIPTS))

format: setup  ## let ruff format the code and mend what it can
	$(RUN) python -m ruff check --fix $(wildcard $(PYTHON_SOURCES))
	$(RUN) python -m ruff format $(wildcard $(PYTHON_SOURCES))

physics: setup  ## write the forms of the motor for numpy, torch and C from white_box/declaration.py
	$(RUN) python ros_ws/make_forms.py

docs: setup  ## write docs/API.md from the code
	$(RUN) python docs/make_api.py

bench: setup  ## run one benchmark (NAME=identification QUICK=1)
	@[ -n '$(NAME)' ] || { echo "bench: error: NAME is missing; expected one of: $(basename $(notdir $(wildcard benchmarks/[a-z]*.py)))" >&2; exit 2; }
	@[ -f 'benchmarks/$(NAME).py' ] || { echo "bench: error: no benchmark $(NAME); expected one of: $(basename $(notdir $(wildcard benchmarks/[a-z]*.py)))" >&2; exit 2; }
	@cmp -s ros_ws/requirements/locked/bench.txt .venv/.bench_installed || { echo 'bench: installing the peers (once)'; \
		$(RUN) python -m pip install --quiet --no-input --disable-pip-version-check --require-hashes --no-deps \
			--no-build-isolation --requirement ros_ws/requirements/locked/bench.txt \
		&& cp ros_ws/requirements/locked/bench.txt .venv/.bench_installed; }
	@$(RUN) python 'benchmarks/$(NAME).py' $(if $(QUICK),--quick) $(ARGS)

clean:  ## remove what was built and cached (recordings and .venv stay)
	rm -rf ros_ws/build ros_ws/install ros_ws/log .pytest_cache .mypy_cache .ruff_cache
	find src tests benchmarks examples ros_ws -name __pycache__ -prune -exec rm -rf {} +
	rm -f src/*/*/*/*.so

distclean: clean  ## clean, and remove .venv too
	rm -rf .venv
