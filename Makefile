# `make demo` and `make test` are all a fresh machine needs: git, make and Python 3.11 to 3.14 with
# venv. setup.sh looks for one; `make demo PYTHON=/path/to/python3.12` names one.
export PYTHON
# Compiled once instead of in each of the many processes that the tests start.
unexport PYTHONDONTWRITEBYTECODE
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test timing test-long test-lerobot test-data-sets test-tools check check-arm64 bench campaign pictures release site clean browser installed-dev

demo:
	@./setup.sh --with viewer
	$(BIN)/so101 demo

# Who takes what, with two workers and with more: tests/harness/lanes.py.
WORKERS ?= 3
PYTEST = $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder
test: browser
	$(PYTEST)

# make test, and what each folder of it costs, for tests/README.md.
timing: browser
	PYTHONPATH=tests $(PYTEST) -p timing --junitxml build/times.xml
	$(BIN)/python tests/timing.py build/times.xml --write

# What takes too long for every push; writes tests/LONG.md. PARTS="laws campaign" runs some.
test-long: browser
	$(BIN)/python tests/long.py $(PARTS)

# LeRobot's own commands through the plugin, on emulated arms. LeRobot needs Python 3.12 or newer and
# some gigabytes; LEROBOT_PYTHON=/path/to/python3.12 names one.
test-lerobot:
	@tests/genuine_lerobot/run.sh

# Data sets that genuine releases of LeRobot write.
test-data-sets:
	@tests/genuine_lerobot/data_sets.sh

# The robot description in six programs, and mesh files of ten (6 GB of packages).
test-tools:
	@tests/genuine_tools/run.sh

check: installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	@$(MAKE) test

# A release on Debian 12 and 13 of an emulated Raspberry Pi; needs root, mmdebstrap and qemu.
check-arm64: release
	$(BIN)/python tests/machines/try_arm64.py

bench: browser
	@./setup.sh --with bench
	$(BIN)/python -m benchmarks.bench_ik
	$(BIN)/python -m benchmarks.bench_retime
	$(BIN)/python -m benchmarks.bench_plan
	$(BIN)/python -m benchmarks.bench_routes
	$(BIN)/python -m benchmarks.bench_no_path
	$(BIN)/python -m benchmarks.bench_replan
	$(BIN)/python -m benchmarks.bench_many
	$(BIN)/python -m benchmarks.bench_fair
	$(BIN)/python -m benchmarks.bench_line
	$(BIN)/python -m benchmarks.bench_give_up
	$(BIN)/python -m benchmarks.bench_boxes
	$(BIN)/python -m benchmarks.bench_servo
	$(BIN)/python -m benchmarks.bench_module
	$(BIN)/python -m benchmarks.bench_bus
	$(BIN)/python -m benchmarks.bench_emulator
	$(BIN)/python -m benchmarks.bench_follow
	$(BIN)/python -m benchmarks.bench_stream
	$(BIN)/python -m benchmarks.bench_stop
	$(BIN)/python -m benchmarks.bench_teleop
	$(BIN)/python -m benchmarks.bench_following
	$(BIN)/python -m benchmarks.bench_cycle
	$(BIN)/python -m benchmarks.bench_dataset
	$(BIN)/python -m benchmarks.bench_jog
	$(BIN)/python -m benchmarks.bench_page

# Attacks the bus and the module at random, with so many seeds for each attack; SEED=... repeats a run.
EXAMPLES ?= 50
campaign: installed-dev
	$(BIN)/python -m pytest -m campaign --timeout 7200 --examples $(EXAMPLES) --hypothesis-seed $(or $(SEED),$(shell date +%s))

pictures: browser
	$(BIN)/python docs/make_screenshots.py
	$(BIN)/python docs/make_films.py

# Wheel, source distribution, archives, bill of materials and checksums of the last commit, in dist/.
release: installed-dev
	$(BIN)/python release.py

site:
	@./setup.sh --with site
	$(BIN)/properdocs build --strict
	@echo "To read it: $(BIN)/python -m http.server -d site, then http://localhost:8000"

browser: installed-dev
	@sh tests/browser/install_browser.sh $(BIN)

installed-dev:
	@./setup.sh --with dev

clean:
	rm -rf $(VENV) .venv-lerobot .venv-tools build dist site wheels setup.log .setup.lock *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
