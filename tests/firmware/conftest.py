"""Builds the controller's program and the simulated chip, once a session."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from firmware.simulation.simulated_chip import Chip, build, missing_tools
from firmware.simulation.simulated_stm32 import Stm32, missing_stm32_tools

AVR_PACKAGES = "gcc gcc-avr avr-libc libsimavr-dev"
ARDUINO_CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker("firmware")


def need_tools(missing: Sequence[str], packages: str) -> None:
    if not missing:
        return
    message = f"missing: {', '.join(missing)}; on Debian: apt-get install {packages}"
    if os.environ.get("WHEELSIGHT_REQUIRE_FIRMWARE") == "1":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the program (controller.elf) and the simulator (chip)."""
    need_tools(missing_tools(), AVR_PACKAGES)
    folder = tmp_path_factory.mktemp("firmware")
    build("simulation", folder)
    (folder / "size.txt").write_text(build("atmega8", folder))
    return folder


@pytest.fixture(scope="session")
def rising_edges(built: Path) -> Path:
    """The program built to count rising edges alone."""
    folder = built / "rising"
    build("atmega8", folder, "EDGES=1")
    return folder / "controller.elf"


@pytest.fixture
def chip(built: Path) -> Iterator[Chip]:
    """A chip, a tenth of a second after power came on, whose line is empty."""
    with Chip(built / "chip", built / "controller.elf") as chip:
        chip.run(0.1)
        chip.messages()
        yield chip


@pytest.fixture(scope="session")
def built_sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the Arduino's sketch (plain_counts.elf) and a simulated Uno (chip)."""
    need_tools(missing_tools() if ARDUINO_CORE.is_dir() else ["Arduino's core"], AVR_PACKAGES + " arduino-core-avr")
    folder = tmp_path_factory.mktemp("arduino")
    build("simulation", folder, "CHIP=atmega328p", "HZ=16000000")
    (folder / "size.txt").write_text(build("arduino", folder))
    return folder


@pytest.fixture(scope="session")
def built_stm32(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the STM32F4's program, controller.bin."""
    need_tools(missing_stm32_tools(), "gcc-arm-none-eabi; by pip: unicorn")
    folder = tmp_path_factory.mktemp("stm32f4")
    (folder / "size.txt").write_text(build("stm32f4", folder))
    return folder


@pytest.fixture
def board(built_stm32: Path) -> Iterator[Stm32]:
    """A board, a tenth of a second after power came on, whose line is empty."""
    with Stm32(built_stm32 / "controller.bin") as board:
        board.run(0.1)
        board.messages()
        yield board
