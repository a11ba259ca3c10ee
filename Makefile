# make help says what there is. PYTHON=/path/to/python picks another interpreter for make setup.
.DEFAULT_GOAL := help
.PHONY: help setup lint type test test-slow demo bench clean

# A sourced ROS brings its own rclpy; the environment is then made another way (tools/setup.sh).
MODE := $(if $(ROS_DISTRO)$(AMENT_PREFIX_PATH),apt,wheels)
PY := .venv/bin/python
# Processes that run tests side by side, each with one thread of BLAS; the tests of one file stay together.
WORKERS ?= 4
# Tests over the middleware wait most of their time: begun first, they leave no processor idle at the end.
FOLDERS = test/ros $(filter-out test/ros,$(patsubst %/,%,$(wildcard test/*/)))
STAMP := .venv/.ready-$(MODE)
BENCHMARKS := $(sort $(wildcard benchmarks/*.py))

# Started from inside the environment, the guard of its ROS wheels would reach other interpreters.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

help:
	@echo "make setup   the environment .venv: Python, pinned packages, system libraries"
	@echo "make test    the tests, those over DDS too; make test-slow those of ten seconds and more each"
	@echo "make lint    ruff"
	@echo "make type    mypy --strict on the layers that run without ROS"
	@echo "make demo    simulate a drive, play it to the node, show its decisions; leaves out/demo/"
	@echo "make bench   every script of benchmarks/"
	@echo "make clean   remove what was built and measured (.venv and out/ stay)"

setup: $(STAMP)

$(STAMP): setup.py setup.cfg Makefile $(wildcard constraints/*.txt) $(wildcard tools/*.sh)
	@tools/setup.sh $(MODE)
	@rm -f .venv/.ready-*
	@touch $@

lint: setup
	$(PY) -m ruff check .

type: setup
	$(PY) -m mypy

test: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PY) -m pytest -m "not slow" -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(FOLDERS)

test-slow: setup
	$(PY) -m pytest -m slow

demo: setup
	$(PY) -m svc_ros.ros.demo --out out/demo

bench: setup
	@test -n "$(BENCHMARKS)" || { echo "error: benchmarks/ has no script to run" >&2; exit 1; }
	@set -e; for script in $(BENCHMARKS); do echo "== $$script"; $(PY) $$script; done

clean:
	rm -rf build install log dist svc_ros.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find svc_ros test benchmarks launch -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
