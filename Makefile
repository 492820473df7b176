# Each target sets up what it needs in .venv from a bare python3 with venv; a fresh clone needs nothing else.
#
#   make demo [RECORDING=folder]   the main job on one recording, and its report
#   make test [SLOW=1]             all tests that take seconds; with SLOW=1 (or CI=true) the slow ones too
#   make check                     ruff, mypy --strict, import layers, documentation
#   make bench                     side by side with OpenCV and Open3D on the real recordings; kept in BENCHMARKS.md
#   make firmware                  the wheel controller's program, and its size
#   make docs | wheel | clean

PYTHON ?= python3
DATA := $(or $(WHEELSIGHT_DATA),../shared/data)
RECORDING ?= $(patsubst %/,%,$(firstword $(sort $(wildcard $(DATA)/rgbd/*/))))
OUT ?= out/demo

VENV := .venv
BIN := $(VENV)/bin
QUICK := $(if $(filter-out false 0,$(CI) $(SLOW)),,-m "not slow")

.PHONY: demo test check bench docs firmware wheel clean recording

demo: recording $(VENV)/.installed-core
	$(BIN)/wheelsight run "$(RECORDING)" --odometry features --out "$(OUT)" --force

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(QUICK) $(ARGS)

check: $(VENV)/.installed-dev docs
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/python -m pytest --quiet tests/test_layers.py

bench: $(VENV)/.installed-bench
	$(BIN)/python -m benchmarks $(or $(ARGS),--out BENCHMARKS.md)

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

firmware:
	@command -v avr-gcc >/dev/null || { echo 'avr-gcc is missing; on Debian: apt-get install gcc-avr avr-libc' >&2; exit 1; }
	$(MAKE) --no-print-directory -C firmware/atmega8

wheel: $(VENV)/.installed-core
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf build dist site out/demo firmware/*/build .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

recording:
	$(if $(RECORDING),,$(error No recording under $(DATA)/rgbd: get one from the TUM RGB-D benchmark's download page \
	(e.g. freiburg1_xyz), unpack it, and say: make demo RECORDING=its/folder))

# One stamp an extra; `core` is wheelsight without any.
$(VENV)/.installed-%: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.$(if $(filter core,$*),,[$*])'
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo 'wheelsight needs Python 3.11 or newer; name one: make PYTHON=python3.12' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo 'This Python cannot make environments; on Debian: apt-get install python3-venv' >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
