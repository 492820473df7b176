"""What wheel readings say of their counters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.messages import WheelSpeeds, WheelTicks
from wheelsight.io.recordings import RecordingWriter, open_recording
from wheelsight.io.recordings.clock_checks import counter_warnings
from wheelsight_calibration.wheel_drive import drive_of

SMALL = Wheels(0.033, 0.033, 0.16, 4096.0)


def readings(modulus: int, start: int = 1000, *, backwards: bool = False) -> list[WheelTicks]:
    """Ten seconds at 0.2 m/s, which is 964 counts a second, as a counter shows them that wraps at a modulus."""
    counts = start + np.rint(964 * 0.02 * np.arange(501)).astype(int) * (-1 if backwards else 1)
    return [WheelTicks(0.02 * i, int(count) % modulus, int(count + 37) % modulus) for i, count in enumerate(counts)]


@pytest.mark.parametrize("bits", [10, 12, 13])
@pytest.mark.parametrize("backwards", [False, True])
def test_the_width_of_counters_that_wrap_unsaid_is_reported(bits: int, backwards: bool) -> None:
    (reported,) = counter_warnings(SMALL, readings(2**bits, backwards=backwards))
    assert f"it seems to wrap at {2**bits}: set wheels.counter_bits to {bits}" in reported
    assert not counter_warnings(replace(SMALL, counter_bits=bits, max_speed_m_s=1.0), readings(2**bits))


def test_where_it_leaps_is_reported() -> None:
    (reported,) = counter_warnings(SMALL, readings(4096, start=4040))
    assert reported.startswith("The right counter leaps from 4077 to 0 at 0.020 s")


@pytest.mark.parametrize("modulus", [900, 3600])
def test_a_modulus_is_reported_about(modulus: int) -> None:
    (reported,) = counter_warnings(SMALL, readings(modulus))
    about = int(reported.split("about ")[1].split(":")[0])
    assert about == pytest.approx(modulus, rel=0.02)
    assert "set wheels.counter_modulus" in reported
    assert not counter_warnings(replace(SMALL, counter_modulus=modulus, max_speed_m_s=1.0), readings(modulus))


def test_a_width_that_is_set_too_large_is_reported_as_well() -> None:
    (reported,) = counter_warnings(replace(SMALL, counter_bits=16), readings(4096))
    assert "set wheels.counter_bits to 12" in reported


def sound() -> dict[str, Sequence[WheelTicks | WheelSpeeds]]:
    steady = readings(2**40)
    there_and_back = [WheelTicks(r.stamp_s, *(abs(n - 5000) for n in (r.left, r.right))) for r in steady]
    reset = [r if i < 300 else WheelTicks(r.stamp_s, i - 300, i - 300) for i, r in enumerate(steady)]
    return {
        "steady": steady,
        "there and back": there_and_back,
        "standing": [WheelTicks(0.02 * i, 7, 7) for i in range(100)],
        "one tick": [WheelTicks(0.02 * i, i // 50, i // 50) for i in range(100)],
        "reset once": reset,
        "speeds": [WheelSpeeds(0.02 * i, 1.0, -1.0) for i in range(100)],
        "few": steady[:3],
        "none": [],
    }


@pytest.mark.parametrize("kind", list(sound()))
def test_counters_that_are_as_they_should_be_raise_no_word(kind: str) -> None:
    assert counter_warnings(SMALL, sound()[kind]) == []
    assert counter_warnings(None, sound()[kind]) == []


def test_counters_that_go_round_unseen_are_reported_with_the_speed_that_they_bear() -> None:
    wheels = Wheels(0.17, 0.17, 0.52, 3200.0, counter_bits=8)
    slow = [WheelTicks(0.02 * i, 20 * i % 256, 20 * i % 256) for i in range(100)]
    (reported,) = counter_warnings(wheels, slow)
    assert "may roll over unseen at 5 m/s" in reported
    assert "below 2.1" in reported
    assert not counter_warnings(replace(wheels, max_speed_m_s=1.5), slow)


def test_an_opened_recording_warns_and_wide_counters_lose_nothing_in_a_drive(tmp_path: Path) -> None:
    for name, bits, given in (("narrow", 0, readings(4096)), ("wide", 64, readings(2**64, 5, backwards=True))):
        calibration = Calibration(wheels=replace(SMALL, counter_bits=bits), source="test")
        with RecordingWriter(tmp_path / name, calibration) as writer:
            for reading in given:
                writer.add(reading)
    assert any("seems to wrap at 4096" in warning for warning in open_recording(tmp_path / "narrow").warnings)
    wide = open_recording(tmp_path / "wide")
    assert wide.warnings == ()
    assert wide.calibration.wheels is not None
    drive = drive_of(wide, wide.calibration.wheels)
    assert drive.left_rad[-1] == pytest.approx(-9640 * 2 * np.pi / 4096)
