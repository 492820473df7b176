# Each target sets up what it needs in .venv from a bare python3 with venv; a fresh clone needs nothing else.
#
#   make demo                      simulate a lap with mishaps, join wheels and camera, map, report against truth; then a robot
#                                  explores a home of two rooms, closes its loops, and is switched off; on the next day it is
#                                  switched on in the other room, finds itself, and drives to a goal while a person walks
#   make demo RECORDING=folder     the same of a recording you have; ODOMETRY=wheels where it has no images
#   make test [SLOW=1] [WORKERS=n] all tests that take seconds; with SLOW=1 (or CI=true) the slow ones too
#   make check                     ruff, mypy --strict, import layers, documentation
#   make lowest                    the tests that touch each library, by the lowest versions that pyproject.toml allows
#   make bench                     side by side with OpenCV and Open3D on the real recordings; kept in docs/benchmarks/peers.md
#   make firmware                  the wheel controllers' programs, for the ATmega8 and the STM32F4, and their sizes
#   make docs | wheel | clean

PYTHON ?= python3
RECORDING ?=
ODOMETRY ?=
OUT ?= out/demo
# Processes that tests are shared between, one more than cores; the one that runs out of tests takes of another's.
WORKERS ?= auto

VENV := .venv
BIN := $(VENV)/bin
QUICK := $(if $(filter-out false 0,$(CI) $(SLOW)),,-m "not slow")

# Which library each of them is about: typer and rich, numba and scipy, shapely, OpenCV, pyserial and cobs, plotly,
# scikit-learn and skops, MuJoCo and matplotlib, scikit-image, rosbags, PyAV, Starlette with uvicorn and websockets, Dask, GTSAM.
# Kernels take minutes: with the lowest numba those of dense and joined odometry compile, not those of features and renderer.
LOWEST := .venv-lowest
LOWEST_TESTS := tests/test_package.py tests/cli/test_app.py tests/cli/test_run_wheels.py \
	tests/geometry/test_camera.py tests/geometry/test_se3.py tests/test_areas.py tests/calibration/test_detection.py tests/devices/test_protocol.py \
	tests/devices/test_realsense.py tests/report/test_report_page.py tests/places/test_storage.py tests/simulation/test_holonomic.py \
	tests/mapping/test_export.py tests/recordings/rosbag/test_formats.py tests/recordings/test_azure_kinect.py \
	tests/live_page/test_server.py tests/live_page/test_access.py tests/batch/test_fleet.py tests/slam/test_solvers.py \
	tests/localizer/test_by_fusion.py

.PHONY: demo test lowest check style types bench docs firmware wheel clean

ifeq ($(RECORDING),)
# A lap of a square of 4 m at 320×240 by a wheelchair whose wheels are not quite what its owner measured, as wheels never
# are. On the way something lies on the camera, and a wheel is lifted.
# Then another looks at a home that it does not know, at 5 images a second, which halves the work. On the next day it is
# switched on in the other room, in other light and with chairs elsewhere, and nobody tells it where.
demo: $(VENV)/.installed-sim,report,web
	$(BIN)/wheelsight simulate square --rate 10 --right-radius 0.171 --track 0.525 --cover 10:13 --lift 19:22 \
		--out "$(OUT)/drive" --force
	$(BIN)/wheelsight run "$(OUT)/drive" --odometry wheels,dense --map surfels --out "$(OUT)/results" --force
	$(BIN)/wheelsight drive --sim studio --rate 5 --explore --out "$(OUT)/explored" --force
	-$(BIN)/wheelsight drive --sim studio --rate 5 --day 1 --people 1 --start 6,1.7,90 --map "$(OUT)/explored" \
		--to 0,0,0 --out "$(OUT)/driven" --force
	@echo
	@echo 'What became of it, each a page that needs no network:'
	@echo '  $(OUT)/results/report.html   wheels and camera joined, against the truth'
	@echo '  $(OUT)/explored/drive.html   how it looked at all rooms, with the loops that it closed'
	@echo '  $(OUT)/driven/drive.html     how it found itself on the next day, and drove to its goal'
	@echo
	@echo 'Click a goal yourself, and see it arrive; Ctrl-C ends it:'
	@echo '  $(BIN)/wheelsight serve --sim studio --map "$(OUT)/explored" --known-start 0,0,0'
	@grep -qs '"has_arrived": true' "$(OUT)/driven/drive.json" || { echo 'The robot did not arrive at its goal; why is in driven/drive.html.' >&2; exit 1; }
else
demo: $(VENV)/.installed-report
	$(BIN)/wheelsight run "$(RECORDING)" $(if $(ODOMETRY),--odometry "$(ODOMETRY)") --out "$(OUT)/results" --force
endif

# What pytest and programs that tests start have translated is kept for the next, wherever the environment says otherwise.
test: export PYTHONDONTWRITEBYTECODE :=
test: $(VENV)/.installed-dev
	$(if $(QUICK),,$(BIN)/python tests/warm_up.py)
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal $(QUICK) $(ARGS)

# Old libraries warn of what newer companions of theirs deprecate; what counts is that they work.
lowest: export NUMBA_CACHE_DIR := $(CURDIR)/$(LOWEST)/kernels
lowest: $(LOWEST)/.installed
	$(LOWEST)/bin/wheelsight --help >$(LOWEST)/help.txt
	$(LOWEST)/bin/python -m pytest --numprocesses $(WORKERS) --dist worksteal -m "not slow" -p no:cacheprovider \
		-W ignore::DeprecationWarning $(LOWEST_TESTS)

check: style types docs

style: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/python -m pytest --quiet --numprocesses 0 tests/test_layers.py

types: $(VENV)/.installed-dev
	$(BIN)/mypy

bench: $(VENV)/.installed-bench
	$(BIN)/python -m benchmarks $(or $(ARGS),--out docs/benchmarks/peers.md)

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
# What is imported is compiled then: of 17 000 files that is a part.
$(VENV)/.installed-%: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable '.$(if $(filter core,$*),,[$*])'
	@touch $@

# There are wheels of all of them for Python 3.11 and 3.12.
$(LOWEST)/.installed: pyproject.toml tests/lowest_versions.py
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' || { \
	  echo 'The lowest versions are of Python 3.11 and 3.12; name one: make lowest PYTHON=python3.11' >&2; exit 1; }
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python tests/lowest_versions.py >$(LOWEST)/lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --requirement $(LOWEST)/lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --editable .
	$(LOWEST)/bin/python -m pip check --quiet
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo 'wheelsight needs Python 3.11 or newer; name one: make PYTHON=python3.12' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo 'This Python cannot make environments; on Debian: apt-get install python3-venv' >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
