# Each target sets up what it needs in .venv from a bare python3 with venv; a fresh clone needs nothing else.
#
#   make demo                      simulate two laps with mishaps, join wheels and camera, close the loop, map, report against truth;
#                                  then a robot finds itself in that map on another day, and drives to a goal around a person
#   make demo RECORDING=folder     the same of a recording you have; ODOMETRY=wheels where it has no images
#   make test [SLOW=1] [WORKERS=n] all tests that take seconds; with SLOW=1 (or CI=true) the slow ones too
#   make check                     ruff, mypy --strict, import layers, documentation
#   make bench                     side by side with OpenCV and Open3D on the real recordings; kept in BENCHMARKS.md
#   make firmware                  the wheel controllers' programs, for the ATmega8 and the STM32F4, and their sizes
#   make docs | wheel | clean

PYTHON ?= python3
RECORDING ?=
ODOMETRY ?=
OUT ?= out/demo
# Processes that tests are shared between; the one that runs out of tests takes of another's.
WORKERS ?= auto

VENV := .venv
BIN := $(VENV)/bin
QUICK := $(if $(filter-out false 0,$(CI) $(SLOW)),,-m "not slow")

.PHONY: demo test check bench docs firmware wheel clean

ifeq ($(RECORDING),)
# Two laps of a square of 4 m at 320×240 by a wheelchair whose wheels are not quite what its owner measured, as wheels
# never are. On the way something lies on the camera, and a wheel is lifted. On the second lap the first is recognised.
# Then a robot finds itself in that map on another day, and drives to a goal around a person who walks there.
demo: $(VENV)/.installed-sim,report
	$(BIN)/wheelsight simulate square --laps 2 --rate 10 --right-radius 0.171 --track 0.525 --cover 10:13 --lift 19:22 \
		--out "$(OUT)/drive" --force
	$(BIN)/wheelsight run "$(OUT)/drive" --odometry wheels,dense --map surfels --loops keyframes \
		--out "$(OUT)/results" --force
	-$(BIN)/wheelsight drive --sim square --day 1 --people 1 --map "$(OUT)/results" --to 4,0.5,90 \
		--out "$(OUT)/driven" --force
	@echo
	@echo 'The loop is in the report, before and after. This finds the robot in that map again, on a recording of your own'
	@echo 'or on the same one:'
	@echo '  $(BIN)/wheelsight run "$(OUT)/drive" --map-from "$(OUT)/results" --out "$(OUT)/found" --force'
else
demo: $(VENV)/.installed-report
	$(BIN)/wheelsight run "$(RECORDING)" $(if $(ODOMETRY),--odometry "$(ODOMETRY)") --out "$(OUT)/results" --force
endif

# What pytest and programs that tests start have translated is kept for the next, wherever the environment says otherwise.
test: export PYTHONDONTWRITEBYTECODE :=
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal $(QUICK) $(ARGS)

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
	@command -v arm-none-eabi-gcc >/dev/null || { echo 'arm-none-eabi-gcc is missing; on Debian: apt-get install gcc-arm-none-eabi' >&2; exit 1; }
	$(MAKE) --no-print-directory -C firmware/atmega8
	$(MAKE) --no-print-directory -C firmware/stm32f4

wheel: $(VENV)/.installed-core
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf build dist site out/demo firmware/*/build .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

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
