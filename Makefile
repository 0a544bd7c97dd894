# Needs Python 3.11 or newer, make and a package index. Everything else is installed into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: real figures mutants faults kills wrong hostile arms test-arms test-arms-new test-arms-steps peers coverage branches player docs demo test test-docs test-docs-apart test-docs-story test-slow check bench exam exam-quick format clean

$(VENV)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	# --no-compile: compiling every module would take a third of the installation time; they compile on first import
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e ".[dev]"
	touch $@

demo: $(VENV)/ready  ## all steps on the mock arm
	$(BIN)/calib demo

# these take hundreds of megabytes and compile most kernels, so they run in processes of their own
LARGE := tests/calib/test_claims.py tests/safety/test_execution.py tests/safety/test_tube.py

test: $(VENV)/ready  ## the tests that CI runs; the drivers' tests run last, because they keep real time
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(LARGE)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(LARGE:%=--ignore=%) --ignore=tests/drivers
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -r R tests/drivers

# these need nothing of the other blocks, so `make --jobs` runs them beside those
APART := demo or add-an-arm
test-docs: test-docs-apart test-docs-story  ## every command block of README and docs, in reading order

test-docs-apart: $(VENV)/ready
	$(BIN)/python -m pytest -m slow -k "$(APART)" tests/test_docs.py

test-docs-story: $(VENV)/ready
	$(BIN)/python -m pytest -m slow -k "not ($(APART))" tests/test_docs.py

test-slow: $(VENV)/ready  ## fuzzing, mutation, long soaks
	$(BIN)/python -m pytest -m slow

fuzz: $(VENV)/ready  ## mutants of every file format that is read, at length
	$(BIN)/python -m pytest -m slow tests/benchmarks/test_hostile.py tests/logs/test_hostile.py

mutants: $(VENV)/ready  ## mutate every predicate of safety/; resumes from build/mutants.jsonl
	MUTANTS=build/mutants.jsonl $(BIN)/python -m pytest -m slow tests/safety/test_mutated_predicates.py

faults: $(VENV)/ready  ## inject every fault 200 times; ten minutes per run, the next run resumes
	$(BIN)/python -m benchmarks faults

kills: $(VENV)/ready  ## kill the recording and the control process 300 times; ten minutes per run, the next run resumes
	$(BIN)/python -m benchmarks kills

wrong: $(VENV)/ready  ## give 500 wrong recordings to every command; ten minutes per run, the next run resumes
	$(BIN)/python -m benchmarks wrong_commands

hostile: $(VENV)/ready  ## give 10,000 mutated files, readings and arguments to every command; ten minutes per run, the next run resumes
	$(BIN)/python -m benchmarks hostile_commands

soak: $(VENV)/ready  ## half an hour of motion on each of six rough arms; ten minutes per run, the next run resumes
	$(BIN)/python -m benchmarks soak

ur-load: $(VENV)/ready  ## a UR on a busy computer: a long recording, and every fault; twelve minutes per run, the next run resumes
	$(BIN)/python -m benchmarks ur_load

branches: $(VENV)/ready  ## branch coverage of safety/, including its child processes
	$(BIN)/python -m coverage erase
	$(BIN)/python -m coverage run -m pytest tests/safety -m "slow or not slow" --ignore=tests/safety/test_mutated_predicates.py --ignore=tests/safety/test_mutants.py
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

check: $(VENV)/ready  ## style, types, import directions
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(VENV)/ready  ## the generated pages, then the site in build/site
	$(BIN)/python -m calib.report.catalogue docs
	$(BIN)/python -m calib.terminal.cheat_sheet docs
	$(BIN)/zensical build --strict

figures: $(VENV)/ready  ## rebuild the tables of README and docs from results/; list outdated results
	$(BIN)/python -m benchmarks.figures

bench: $(VENV)/ready  ## measure the fast figures; writes results/
	$(BIN)/python -m benchmarks

real: $(VENV)/ready  ## identify and diagnose the recordings of real arms in ARM_CALIB_DATA; writes results/real.json
	$(BIN)/python -m benchmarks.real

exam: $(VENV)/ready  ## 300 blind cases, and effects in real recordings if ARM_CALIB_DATA is set; takes hours; EXAM="--jobs 2 --keep"
	$(BIN)/python -m benchmarks.exam run --count 300 --final $(EXAM)
	$(BIN)/python -m benchmarks.exam real

exam-quick: $(VENV)/ready  ## the first 25 cases
	$(BIN)/python -m benchmarks.exam run --count 25 $(EXAM)

peers:  ## install figaroh and mujoco.sysid into their own environment, for comparison by `python -m benchmarks peers`
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check "figaroh==1.0.2" "mujoco[sysid]==4.0.0"

coverage: $(VENV)/ready  ## coverage of the stated intervals: 50 arms on the mock, 200 by formula; about ten minutes
	$(BIN)/python -m benchmarks coverage

$(VENV)/arms: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --no-deps "example-robot-data==6.0.0"
	touch $@

arms: $(VENV)/arms  ## 29 published arms through all steps on the mock; half an hour per run, the next run resumes
	$(BIN)/python -m benchmarks arms

# the first needs most facts that its file does not state, the second has the largest file; `make arms` takes all
EACH := pr2_right icub_right
test-arms: test-arms-new test-arms-steps  ## `calib arm new` on two published arms, all steps on one more; some minutes

test-arms-new: $(VENV)/arms
	$(BIN)/python -m benchmarks.arms --new $(EACH)

test-arms-steps: $(VENV)/arms
	$(BIN)/python -m benchmarks.arms double_pendulum

player:  ## rebuild the 3D player from its source; the only target that needs Node.js
	cd calib/report/web && npm ci && npm run build
	cd calib/report/web && sha256sum player.js package-lock.json > ../assets/player.sha256

clean:
	rm -rf $(VENV) .venv-peers build dist
