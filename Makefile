# `make demo` and `make test` are all a fresh machine needs: Python 3.11 with venv and pip, git, make.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
RUNS := $(VENV)/.installed
STAMP := $(VENV)/.installed-dev

.PHONY: demo test check bench pictures site clean browser

demo: $(RUNS)
	$(BIN)/so101 demo

test: $(STAMP) browser
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: $(STAMP) browser
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n 2 --dist loadfile

bench: $(STAMP) browser
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[bench]'
	$(BIN)/python -m benchmarks.bench_ik
	$(BIN)/python -m benchmarks.bench_retime
	$(BIN)/python -m benchmarks.bench_plan
	$(BIN)/python -m benchmarks.bench_line
	$(BIN)/python -m benchmarks.bench_servo
	$(BIN)/python -m benchmarks.bench_module
	$(BIN)/python -m benchmarks.bench_bus
	$(BIN)/python -m benchmarks.bench_follow
	$(BIN)/python -m benchmarks.bench_stream
	$(BIN)/python -m benchmarks.bench_teleop
	$(BIN)/python -m benchmarks.bench_page

pictures: $(STAMP) browser
	$(BIN)/python docs/make_screenshots.py

site: $(BIN)/python
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[site]'
	$(BIN)/properdocs build --strict

browser: $(STAMP)
	@sh tests/browser/install_browser.sh $(BIN)

# What install.py asks for, and the page.
$(RUNS): pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[viewer]'
	@cat pyproject.toml constraints.txt > $@

$(STAMP): pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@cat pyproject.toml constraints.txt > $(RUNS)
	@touch $@

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "error: $(PYTHON) not found. try: make PYTHON=/path/to/python3.11 (or newer)"; exit 1; }
	$(PYTHON) -m venv $(VENV)

clean:
	rm -rf $(VENV) build dist site wheels setup.log .setup.lock *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
