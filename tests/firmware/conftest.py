"""Builds the controller's program and the simulated chip, once a session."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from simulated_chip import Chip

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
SIMAVR_HEADER = Path("/usr/include/simavr/sim_avr.h")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker("firmware")


def need_tools() -> None:
    missing = [tool for tool in ("make", "cc", "avr-gcc", "avr-size") if shutil.which(tool) is None]
    if not SIMAVR_HEADER.is_file():
        missing.append("libsimavr")
    if not missing:
        return
    message = f"missing: {', '.join(missing)}; on Debian: apt-get install gcc gcc-avr avr-libc libsimavr-dev"
    if os.environ.get("WHEELSIGHT_REQUIRE_FIRMWARE") == "1":
        pytest.fail(message)
    pytest.skip(message)


def build(part: str, folder: Path, *settings: str) -> str:
    """What make says when it builds a part of firmware/ in a folder."""
    command = ["make", "-C", str(FIRMWARE / part), f"BUILD={folder}", *settings]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    return made.stdout


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the program (controller.elf) and the simulator (chip)."""
    need_tools()
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
