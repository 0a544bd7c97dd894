# Needs Python 3.11 or newer, make, and a package index. Everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: real figures mutants faults kills wrong hostile arms test-arms peers coverage branches player docs demo test test-docs test-slow check bench exam exam-quick format clean

$(VENV)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	# modules are compiled when they are first imported; to compile them all takes a third of an installation
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e ".[dev]"
	touch $@

demo: $(VENV)/ready  ## the whole story on the mock arm
	$(BIN)/calib demo

# these take hundreds of megabytes and compile most kernels: in processes of their own, which end with them
LARGE := tests/calib/test_claims.py tests/safety/test_execution.py tests/safety/test_tube.py

test: $(VENV)/ready  ## the tests that CI runs, in two processes; the drivers', which keep real time and mostly wait, after the others, in three
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(LARGE)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(LARGE:%=--ignore=%) --ignore=tests/drivers
	$(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder -r R tests/drivers

test-docs: $(VENV)/ready  ## every command block of README and docs, in the order of a reader
	$(BIN)/python -m pytest -m slow tests/test_docs.py

test-slow: $(VENV)/ready  ## fuzzing, mutation, long soaks
	$(BIN)/python -m pytest -m slow

fuzz: $(VENV)/ready  ## files made to do harm: mutants of everything that is read, at length
	$(BIN)/python -m pytest -m slow tests/benchmarks/test_hostile.py tests/logs/test_hostile.py

mutants: $(VENV)/ready  ## every predicate of safety/ mutated, one after another; cut off, it goes on where it was (build/mutants.jsonl)
	MUTANTS=build/mutants.jsonl $(BIN)/python -m pytest -m slow tests/safety/test_mutated_predicates.py

faults: $(VENV)/ready  ## every fault injected 200 times, ten minutes of them at a time; the next run goes on where this one ends
	$(BIN)/python -m benchmarks faults

kills: $(VENV)/ready  ## 300 kills of the recording and the control process, ten minutes of them at a time; the next run goes on
	$(BIN)/python -m benchmarks kills

wrong: $(VENV)/ready  ## 500 wrong recordings through every command, ten minutes of them at a time; the next run goes on
	$(BIN)/python -m benchmarks wrong_commands

hostile: $(VENV)/ready  ## 10,000 mutated files, readings and arguments through every command, ten minutes of them at a time; the next run goes on
	$(BIN)/python -m benchmarks hostile_commands

soak: $(VENV)/ready  ## half an hour of motion of each of six rough arms, ten minutes of computing at a time
	$(BIN)/python -m benchmarks soak

ur-load: $(VENV)/ready  ## a UR beside two busy processes: a long recording, and each fault by its name; twelve minutes at a time
	$(BIN)/python -m benchmarks ur_load

branches: $(VENV)/ready  ## every branch of safety/, its child processes included
	$(BIN)/python -m coverage erase
	$(BIN)/python -m coverage run -m pytest tests/safety -m "slow or not slow" --ignore=tests/safety/test_mutated_predicates.py --ignore=tests/safety/test_mutants.py
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

check: $(VENV)/ready  ## style, types, direction of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(VENV)/ready  ## the site, in build/site; first the pages that are derived from the catalogue
	$(BIN)/python -m calib.report.catalogue docs
	$(BIN)/python -m calib.terminal.cheat_sheet docs
	$(BIN)/zensical build --strict

figures: $(VENV)/ready  ## README and docs built from results/, and which results are outdated
	$(BIN)/python -m benchmarks.figures

bench: $(VENV)/ready  ## the measured figures, one table; writes results/
	$(BIN)/python -m benchmarks

real: $(VENV)/ready  ## the recordings of real arms in ARM_CALIB_DATA, identified, diagnosed and predicted; writes results/real.json
	$(BIN)/python -m benchmarks.real

exam: $(VENV)/ready  ## 300 blind cases, and effects in real recordings where ARM_CALIB_DATA is set; hours. EXAM="--jobs 2 --keep"
	$(BIN)/python -m benchmarks.exam run --count 300 --final $(EXAM)
	$(BIN)/python -m benchmarks.exam real

exam-quick: $(VENV)/ready  ## the first 25 of them
	$(BIN)/python -m benchmarks.exam run --count 25 $(EXAM)

peers:  ## figaroh and mujoco.sysid in an environment of their own, for `make bench` to measure beside us
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check "figaroh==1.0.2" "mujoco[sysid]==4.0.0"

coverage: $(VENV)/ready  ## whether stated uncertainties are true: 50 arms on the mock, 200 by formula; some ten minutes
	$(BIN)/python -m benchmarks coverage

$(VENV)/arms: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --no-deps "example-robot-data==6.0.0"
	touch $@

arms: $(VENV)/arms  ## 29 published arms through the whole line on the mock, half an hour of them at a time; writes results/arms.json
	$(BIN)/python -m benchmarks arms

# one of each maker, and those of which a fact has to be given
EACH := z1 talos_left tiago tiago_pro_left baxter_left centauro_left kinova_j2s6s200 ur5 xarm7 pr2_right romeo_right icub_right double_pendulum
test-arms: $(VENV)/arms  ## one arm of each maker as far as `calib arm new`, two more through the whole line; some minutes
	$(BIN)/python -m benchmarks.arms --new $(EACH)
	$(BIN)/python -m benchmarks.arms so101 panda

player:  ## rebuild the 3D player of plan.html from its source; needs Node.js, which nothing else here does
	cd calib/report/web && npm ci && npm run build
	cd calib/report/web && sha256sum player.js package-lock.json > ../assets/player.sha256

clean:
	rm -rf $(VENV) .venv-peers build dist
