# `make demo` and `make test` do everything, set-up included; `make help` lists the rest.
# They need Python >= 3.10, a Rust toolchain and make; all they install goes into $(VENV).

PYTHON ?= python3
VENV ?= .venv
# LOCKED=--locked makes cargo fail when Cargo.lock is out of date (continuous integration)
LOCKED ?=
MATURIN := maturin>=1.9,<2

PY := $(VENV)/bin/python
RUN := $(VENV)/bin/celestcore
DEMO := build/demo
PICTURE := docs/images/fermi.png

# each stamp is the time of the last success of a step; a second call only does what has changed
STAMP_VENV := $(VENV)/.stamp-venv
STAMP_WHEEL := dist/.stamp-wheel
STAMP_DEPS := $(VENV)/.stamp-deps
STAMP_READY := $(VENV)/.stamp-ready
# folders are listed too: their time changes when a file goes
SOURCES := $(shell find rust python \( -name __pycache__ -o -name '*.so' -o -name target \) -prune \
             -o -print 2>/dev/null) $(wildcard Cargo.toml Cargo.lock pyproject.toml README.md)

# rustup's folder, in case this shell is older than the Rust installation
export PATH := $(PATH):$(HOME)/.cargo/bin
export PYO3_PYTHON := $(if $(filter /%,$(VENV)),$(PY),$(CURDIR)/$(PY))
export MPLBACKEND := Agg
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# nothing may come between the tests and the installed wheel
unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV CONDA_PREFIX

say = @printf '\n== %s\n' "$(1)"

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help demo test test-rust test-python lint wheel bench fuzz instructions long docs picture \
        clean distclean need-python need-cargo need-rust-tools

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1|\2/p' Makefile | awk -F'|' '{printf "make %-12s %s\n", $$1, $$2}'

demo: $(STAMP_READY)  ## replay a real spacecraft's log, write a result and a report, say where to look
	@mkdir -p $(DEMO)
	$(RUN) replay --sample fermi --filter ukf --withhold 600 \
	  -o $(DEMO)/fermi.parquet --report $(DEMO)/fermi.html --json $(DEMO)/fermi.json
	@printf '\nLook at:\n'
	@printf '  %-24s %s\n' \
	  $(DEMO)/fermi.html    'the report: open it in a browser' \
	  $(DEMO)/fermi.parquet 'attitude, body rate, gyro bias and their sigmas at every sample' \
	  $(DEMO)/fermi.json    'the summary above, for machines'

test: need-rust-tools lint test-rust test-python  ## every check, in Rust and in Python

lint: need-rust-tools $(STAMP_READY)  ## formatting, clippy, ruff, types, stubs
	$(call say,cargo fmt and clippy)
	cargo fmt --all --check
	cargo clippy $(LOCKED) --workspace --all-targets -- -D warnings
	$(call say,ruff)
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(call say,mypy and stubtest)
	$(PY) -m mypy --strict python/celestcore
	$(PY) -m mypy.stubtest celestcore._core

test-rust: need-cargo $(STAMP_VENV)  ## the Rust tests, doctests and documentation
	$(call say,Rust tests)
	@if cargo nextest --version >/dev/null 2>&1; then \
	  set -x; cargo nextest run $(LOCKED) --workspace; \
	else set -x; cargo test $(LOCKED) --workspace --lib --bins --tests; fi
	cargo test $(LOCKED) --workspace --doc
	RUSTDOCFLAGS='-D warnings' cargo doc $(LOCKED) --workspace --no-deps --quiet

test-python: $(STAMP_READY)  ## the Python tests, on the installed wheel
	$(call say,doctests of the installed package)
	$(PY) -m pytest -c pyproject.toml --rootdir=. --doctest-modules --pyargs celestcore
	$(call say,pytest on the installed wheel)
	$(PY) -m pytest tests

long: $(STAMP_READY)  ## the long tests, which `make test` leaves out
	cargo test $(LOCKED) --workspace --release -- --ignored
	$(PY) -m pytest -m long tests || test $$? -eq 5  # 5: there are none

bench: $(STAMP_READY)  ## the benchmarks, on the release build
	@mkdir -p build
	cargo bench $(LOCKED) --package celestcore-core
	$(PY) -m pytest -m bench -s tests || test $$? -eq 5  # 5: there are none
	$(RUN) bench --json build/bench.json

fuzz: need-cargo  ## fuzz the replay core for ten minutes a target; needs cargo-fuzz, no nightly compiler
	for target in replay stream; do \
	  cargo fuzz run --dev --fuzz-dir rust/fuzz --features libfuzzer --sanitizer none $$target -- \
	    -max_total_time=600 -max_len=8000 || exit 1; done

instructions: need-cargo  ## count the instructions of the core's kernels; needs valgrind
	@mkdir -p build
	@$(PYTHON) tools/instructions.py --json build/instructions.json

docs: $(STAMP_READY)  ## build the documentation's site into build/site
	@wheel=$$(echo dist/celestcore-*.whl) && $(PY) -m pip install --quiet "$$wheel[docs]"
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --quiet
	@echo 'Look at build/site/index.html'

picture: $(STAMP_READY)  ## make the README's picture again
	@mkdir -p build $(dir $(PICTURE))
	$(RUN) replay --sample fermi --filter ukf -o build/picture.parquet --report $(PICTURE)

wheel: $(STAMP_READY)  ## build the release wheel into dist/ and install it into the environment
	@ls dist/celestcore-*.whl

clean:  ## remove what was built
	rm -rf build dist target .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find examples python tests tools -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

distclean: clean  ## remove the environment as well
	rm -rf $(VENV)

# --- set-up -----------------------------------------------------------------------------------

$(STAMP_VENV): | need-python need-cargo
	$(call say,Python environment in $(VENV))
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "celestcore: '$(PYTHON) -m venv' does not work; on Debian and Ubuntu, install the package python3-venv." >&2; \
	  exit 1; }
	@$(PY) -m pip install --quiet '$(MATURIN)'
	@touch $@

$(STAMP_WHEEL): $(SOURCES) $(STAMP_VENV) | need-cargo
	$(call say,release wheel (the first time takes a few minutes))
	@rm -rf dist && mkdir -p dist
	$(PY) -m maturin build --release $(LOCKED) --interpreter $(PY) --out dist
	@touch $@

$(STAMP_DEPS): pyproject.toml $(STAMP_VENV) | $(STAMP_WHEEL)
	$(call say,Python packages for running and testing)
	@wheel=$$(echo dist/celestcore-*.whl) && $(PY) -m pip install --quiet "$$wheel[all,test]"
	@touch $@

$(STAMP_READY): $(STAMP_WHEEL) $(STAMP_DEPS)
	@$(PY) -m pip install --quiet --force-reinstall --no-deps dist/celestcore-*.whl
	@touch $@

need-python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || { \
	  echo "celestcore needs Python 3.10 or newer, but '$(PYTHON)' is missing or older: install it from https://www.python.org/downloads/ or name another one, as in 'make demo PYTHON=python3.12'." >&2; \
	  exit 1; }

need-cargo:
	@cargo --version >/dev/null 2>&1 || { \
	  echo "celestcore needs a Rust toolchain, but 'cargo' is missing or does not run: install it from https://rustup.rs and call make again." >&2; \
	  exit 1; }

need-rust-tools: need-cargo
	@{ cargo fmt --version && cargo clippy --version; } >/dev/null 2>&1 || { \
	  echo "celestcore's checks need rustfmt and clippy: 'rustup component add rustfmt clippy' installs them." >&2; \
	  exit 1; }
