# `make` alone lists the targets. Every target makes the environment and builds what it needs; later runs skip what is done.
SHELL := /bin/bash
.SHELLFLAGS := -e -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help build demo demo-control test lint bench faults fuzz soak trials site lock audit clean

PACKAGES := $(patsubst src/%/,%,$(wildcard src/*/))
TYPED := $(filter-out mrd_interfaces mrd_bringup,$(PACKAGES))
LINT := ruff format --check --quiet; ruff check; mypy $(addprefix -p ,$(TYPED))

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' Makefile

build:  ## make the environment (.venv) and build the packages (install/)
	@setup/build

# SEED draws the fault of the demo, and the trial.
SEED ?= 1
demo: build  ## hide a fault in the simulated bench, record and identify it, and let the diagnosis find the fault
	@. ./env.sh; exec python setup/demo.py --seed $(SEED)

demo-control: build  ## run a hybrid test on the simulated bench: an emulated quarter car under a control law
	@. ./env.sh; exec ros2 run mrd_control hybrid_test config/control/hybrid_test.yaml --simulated

# While types are checked, the other core compiles what all tests need. Nodes that keep time come before tests that compute, so that both can run at once. A machine that halts for a second stops
# a bench as it should; such a test is run once more, and the summary says so.
test: build  ## check style and types, then run all tests but the slow ones
	@. ./env.sh; mkdir -p build; python -m mrd_sim.compile_ahead & compiled=$$!; \
	$(LINT); wait $$compiled; \
	python -m pytest --reruns 1 -m 'realtime and not slow' > build/realtime.log 2>&1 & realtime=$$!; \
	nice python -m pytest -n logical --dist loadfile --no-loadscope-reorder -m 'not slow and not realtime' || failed=1; \
	wait $$realtime || failed=1; cat build/realtime.log; [ -z "$$failed" ]

lint: build  ## check style (ruff) and types (mypy)
	@. ./env.sh; $(LINT)

# MOMENTS: random moments at which each node is killed, terminated and stopped.
MOMENTS ?= 3
faults: build  ## break everything that can break, and print what the bench does, three times in a row
	@. ./env.sh; PYTHONPATH="tests:$$PYTHONPATH" python -m faults --times 3 --moments $(MOMENTS)

# COUNT: changed inputs for each kind of input.
COUNT ?= 20000
fuzz: build  ## feed changed inputs to everything that reads
	@. ./env.sh; python fuzz/readers.py --count $(COUNT) --seconds 1e6

# DURATION: s of wall-clock time.
DURATION ?= 1800
soak: build  ## record at 2 kHz for half an hour; print losses, memory and latency
	@. ./env.sh; python benchmarks/recorder.py --duration $(DURATION)

bench: build  ## measure the speed of what must be fast
	@. ./env.sh; failed=; for script in benchmarks/*.py; do python "$$script" || failed="$$failed $$script"; done; \
	[ -z "$$failed" ] || { echo "failed:$$failed" >&2; exit 1; }

# RECORDED is a folder with recordings of measured dampers, one folder a damper, whose motion is replayed.
TRIAL = trials/$(SEED)
trials: build  ## score the diagnosis on dampers whose effects it is not told (hours; goes on where it was interrupted)
	@. ./env.sh; ros2 run mrd_trials make $(TRIAL) --seed $(SEED) $(if $(RECORDED),--recorded $(RECORDED)); \
	ros2 run mrd_trials run $(TRIAL) --output $(TRIAL).verdicts; ros2 run mrd_trials score $(TRIAL) $(TRIAL).verdicts

lock:  ## pin the newest packages that fit setup/*.in (needs uv)
	@cd setup; compile="uv pip compile --quiet --universal --fork-strategy fewest --python-version 3.11 --no-header --no-annotate"; \
	$$compile --upgrade requirements.in ros.in --output-file wheels.lock; \
	$$compile --upgrade requirements.in --constraints system.in --output-file system.lock

audit:  ## look up known vulnerabilities of the pinned packages (needs network)
	@setup/audit

site: build  ## build the documentation as a site (build/site), without network
	@. ./env.sh; python -m sphinx --fail-on-warning --fresh-env --quiet -c docs/site . build/site; \
	echo "python -m http.server --directory build/site"

clean:  ## remove everything that was made, except recorded runs
	@rm -rf .venv .venv-audit build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find src tests setup benchmarks -name __pycache__ -prune -exec rm -rf {} +
