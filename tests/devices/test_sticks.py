"""Joysticks and files of positions of a stick."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from wheelsight.core.errors import DeviceError, RecordingError
from wheelsight.core.messages import StickPosition
from wheelsight.io.devices.sticks import Joystick, StickLog


def event(kind: int, number: int, value: int) -> bytes:
    return struct.pack("<IhBB", 12, value, kind, number)


@pytest.fixture
def device(tmp_path: Path) -> Path:
    """A pipe in place of /dev/input/js0."""
    os.mkfifo(tmp_path / "js0")
    return tmp_path / "js0"


def test_a_joystick_keeps_its_position_until_it_changes(device: Path) -> None:
    with Joystick(device) as stick:
        write = os.open(device, os.O_WRONLY)
        os.write(write, event(0x82, 1, 0) + event(2, 1, -32767) + event(2, 0, 16384))
        position = stick.read(3.0)
        assert position is not None
        assert (position.stamp_s, position.forward, round(position.left, 3)) == (3.0, 1.0, -0.5)
        assert stick.read(4.0) == StickPosition(4.0, 1.0, position.left)
        os.write(write, event(1, 0, 1) + event(2, 1, 32767)[:5])
        held = stick.read(4.1)
        assert held is not None
        assert (held.forward, held.has_override) == (1.0, True)
        os.write(write, event(2, 1, 32767)[5:] + event(1, 0, 0) + event(2, 7, 9))
        assert stick.read(4.2) == StickPosition(4.2, -1.0, position.left)
        os.close(write)
        assert stick.read(4.3) is None
        assert stick.read(4.4) is None


def test_a_joystick_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="js7"):
        Joystick(tmp_path / "js7")


def test_positions_of_a_file_stay_until_the_next(tmp_path: Path) -> None:
    path = tmp_path / "stick.txt"
    path.write_text("# seconds forward left\n0.5 0.4 0\n1.0, -0.2, 0.3, 1\n\n2.0 0 0\n")
    with StickLog(path) as stick:
        assert stick.read(10.0) == StickPosition(10.0)
        assert stick.read(10.7) == StickPosition(10.7, 0.4, 0.0)
        assert stick.read(11.5) == StickPosition(11.5, -0.2, 0.3, has_override=True)
        assert stick.read(12.0) is None


@pytest.mark.parametrize(
    "text", ["", "1 2\n", "0 nan 0\n", "0 1.2 0\n", "1 0 0\n0.5 0 0\n", "0 0 0 1 1\n", "zero 0 0\n"]
)
def test_a_file_with_other_content_names_the_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "stick.txt"
    path.write_text(text)
    with pytest.raises(RecordingError, match="stick"):
        StickLog(path)
