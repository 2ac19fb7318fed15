# The two commands of the README are `make demo` and `make test`; each sets itself up.
# A fresh machine needs a Python of 3.11 to 3.14 with venv, and make. PyBullet is there with 3.11 alone, so that is the
# first choice: with it the tests run both contact engines.
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))
ifndef PYTHON
PYTHON := $(shell for p in python3.11 python3.12 python3.13 python3.14 python3; do \
	$$p -c '$(SUPPORTED)' 2>/dev/null && echo $$p && break; done)
endif
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.ready
QUIET := PIP_DISABLE_PIP_VERSION_CHECK=1

.PHONY: demo test test-sim lint slow prover-campaign clearance-campaign deploy-campaign bench generated lock clean

DEMO := koordgen sim examples/lineform/lineform.koord --fleet examples/lineform/fleet.yaml --duration 30 --seed 1

# In lockstep, because the same seed then gives the same run on every computer, however much else it does.
demo: $(STAMP)
	$(PY) -m $(DEMO) --lockstep --out build/demo
	$(PY) examples/lineform/verdict.py build/demo
	@echo
	@echo "Run it in real time and watch it in a browser:"
	@echo "  $(VENV)/bin/$(DEMO) --live --out build/demo-live"

# Three at a time, one more than there are cores on the smallest machine that it must be quick on, because many tests wait
# for processes. A file's tests stay together, and files keep their order: xdist would begin those with few tests last, and
# some of these take longest. Compiled modules are kept, whatever the shell says: both, and all processes that tests start,
# would else compile everything anew.
test: lint
	PYTHONDONTWRITEBYTECODE= $(PY) -m pytest -n 3 --dist loadfile --no-loadscope-reorder -m "not slow"

# Of the same tests those that depend most on the Python version and its packages.
test-sim: $(STAMP)
	PYTHONDONTWRITEBYTECODE= $(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow" \
	  tests/sim tests/build/emit tests/build/bundle

lint: $(STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy koordgen targets tests benchmarks examples tools

# Up to 90 minutes on two cores; ends with a table of each group's outcomes and times. The chaos tests lay cables between
# network namespaces: they need root, ip and nft.
slow: $(STAMP)
	$(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=20 -m slow

# Random programs against the prover: 20,000 take two hours or more. Run again, it goes on where it ended.
prover-campaign: $(STAMP)
	$(PY) -m tests.verify.prove.campaign --from 0 --count 20000 --folder build/prover-campaign

# Flights and drives through doors, windows and pillars while everything else goes wrong: 500 take half an hour. Run
# again, it goes on where it ended.
clearance-campaign: $(STAMP)
	$(PY) -m tests.sim.run.clearance_campaign --from 0 --count 500 --folder build/clearance-campaign
	$(PY) -m tests.sim.run.clearance_campaign --scenes targets --from 0 --count 100 --folder build/clearance-targets

# Deployments to three hosts with real SSH servers while the deploying process is killed, a link cut, a disk filled or a
# host rebooted: 200 take an hour. Run again, it goes on where it ended. It needs root.
deploy-campaign: $(STAMP)
	$(PY) -m tests.operate.fault_trials --count 200 --folder build/fault-trials

bench: $(STAMP)
	$(PY) benchmarks/compile.py
	$(PY) benchmarks/quad_tracking.py
	$(PY) benchmarks/round.py
	$(PY) benchmarks/sim_autopilot.py
	$(PY) benchmarks/shared_memory.py
	$(PY) benchmarks/car_mpc.py
	$(PY) benchmarks/car_tracking.py
	$(PY) benchmarks/car_planning.py
	$(PY) benchmarks/sim.py
	$(PY) benchmarks/proof_tables.py
	$(PY) benchmarks/proof_composition.py
	$(PY) benchmarks/explore.py
	$(PY) benchmarks/deploy.py

# Parser tables and compiled templates are checked in, because building them at each start costs more than all else.
generated: $(STAMP)
	$(PY) -m koordgen.lang.syntax.generate
	$(PY) -m koordgen.lang.syntax.page
	$(PY) -m koordgen.build.emit.generate
	$(PY) -m tools.generate_solver

$(STAMP): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" && $(PYTHON) -c '$(SUPPORTED)' || \
	  { echo "error: Python 3.11 to 3.14 is needed and $(or $(PYTHON),python3) is none of these; name one with: make $(MAKECMDGOALS) PYTHON=/path/to/python3" >&2; exit 5; }
	@$(PYTHON) -c 'import ensurepip' || \
	  { echo "error: $(PYTHON) has no venv; on Debian: apt-get install $(notdir $(PYTHON))-venv" >&2; exit 5; }
	@test -x $(PY) || $(PYTHON) -m venv $(VENV)
	@echo "setting up $(VENV) with $$($(PY) -V) (once)"
	@$(QUIET) $(PY) -m pip install --quiet -r requirements.lock
	@$(QUIET) $(PY) -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

# Takes the versions of the present environment as the locked ones, with the markers that the lock has. Python 3.11 on
# x86-64 has all packages; any other would lose some.
lock:
	$(PY) -m pip freeze --all --exclude pip --exclude-editable --exclude koordgen > requirements.new
	awk -F== 'NR == FNR { at = index($$0, ";"); if (at) marker[$$1] = substr($$0, at); next } { print $$0 marker[$$1] }' \
	  requirements.lock requirements.new > requirements.marked
	mv requirements.marked requirements.lock
	rm requirements.new

clean:
	rm -rf $(VENV) build dist
