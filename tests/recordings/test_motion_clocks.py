"""The turns of camera and wheels on the sample that ships, with the camera's clock set ahead."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import HolonomicWheels
from wheelsight.core.messages import Event, RgbdFrame, WheelCounts, WheelTicks
from wheelsight.io.recordings import SAMPLE, Recording, open_recording
from wheelsight.io.recordings.clock_checks import MotionClock, MotionOffset
from wheelsight.io.recordings.image_recording import ImageRecording, sure_offset_s
from wheelsight.io.recordings.inspection import inspect_recording
from wheelsight_calibration.wheels import try_calibration

# The controller of the sample stamps its counts so long after the wheels stood so, as real ones do.
_LATENCY_S = 0.016


@pytest.fixture(scope="module")
def sample() -> tuple[Recording, list[Event]]:
    recording = open_recording("sample")
    return recording, list(recording.events())


def _found(sample: tuple[Recording, list[Event]], ahead_s: float, delay_s: float = 0.0) -> MotionOffset:
    recording, events = sample
    wheels = recording.calibration.wheels
    assert wheels is not None
    turns = MotionClock(replace(recording.calibration, wheels=replace(wheels, delay_s=delay_s)))
    for event in events:
        turns.add(replace(event, stamp_s=event.stamp_s + ahead_s) if isinstance(event, RgbdFrame) else event)
    return turns.offset()


@pytest.mark.parametrize("ahead_s", [0.1, 0.3, 1.0, -0.4, 2.5])
def test_a_clock_that_is_ahead_is_found(sample: tuple[Recording, list[Event]], ahead_s: float) -> None:
    found = _found(sample, ahead_s)
    assert found.offset_s == pytest.approx(ahead_s + _LATENCY_S, abs=0.005)
    assert found.is_apart


def test_latency_of_a_controller_is_no_other_clock(sample: tuple[Recording, list[Event]]) -> None:
    assert not _found(sample, 0.0).is_apart


def test_a_delay_that_is_calibrated_counts(sample: tuple[Recording, list[Event]]) -> None:
    found = _found(sample, 0.3, delay_s=-0.3)
    assert found.offset_s == pytest.approx(_LATENCY_S, abs=0.005)


def _copy(folder: Path, ahead_s: float, gyro_ahead_s: float | None = None) -> ImageRecording:
    """The sample as a recording of its own whose camera's clock is ahead of the wheels', and of a gyroscope's."""
    shutil.copytree(SAMPLE, folder)
    head, *rows = (SAMPLE / "wheels.csv").read_text().splitlines()
    readings = [(float(row.split(",")[0]), row.split(",", 1)[1]) for row in rows]
    lines = [f"{stamp_s - ahead_s:.6f},{counts}" for stamp_s, counts in readings]
    (folder / "wheels.csv").write_text("\n".join([head, *lines, ""]))
    if gyro_ahead_s is not None:
        truth = not_none(open_recording("sample").ground_truth)
        yaw_rad = np.unwrap(np.arctan2(truth.T_frame_body[:, 1, 0], truth.T_frame_body[:, 0, 0]))[::2]
        stamps_s = truth.stamps_s[::2]
        rates = np.diff(yaw_rad) / np.diff(stamps_s)
        turned = zip(stamps_s[1:] - gyro_ahead_s, rates, strict=True)
        rows = [f"{stamp_s:.6f},{rate:.6f}" for stamp_s, rate in turned]
        (folder / "gyro.csv").write_text("\n".join(["stamp_s,yaw_rate_rad_s", *rows, ""]))
    recording = open_recording(folder)
    assert isinstance(recording, ImageRecording)
    return recording


@pytest.mark.parametrize("ahead_s", [0.3, -0.4, 1.0])
def test_a_recording_whose_clocks_are_apart_is_put_on_one(tmp_path: Path, ahead_s: float) -> None:
    of_sample = np.array([reading.stamp_s for reading in _copy(tmp_path / "same", 0.0).wheels])
    recording = _copy(tmp_path / "apart", ahead_s)
    stamps_s = np.array([reading.stamp_s for reading in recording.wheels])
    np.testing.assert_allclose(stamps_s, of_sample + _LATENCY_S, atol=0.005)
    events_s = [event.stamp_s for event in recording.listed()]
    assert events_s == sorted(events_s)
    (said,) = [warning for warning in recording.warnings if "turns" in warning]
    assert "The difference is removed (delay_s: " in said
    assert float(re.findall(r"stamps are ([\d.]+) s", said)[0]) == pytest.approx(abs(ahead_s + _LATENCY_S), abs=0.005)
    assert not not_none(inspect_recording(recording).motion).is_apart
    own = recording.as_stamped()
    np.testing.assert_allclose([reading.stamp_s for reading in own.wheels], of_sample - ahead_s, atol=2e-6)
    assert not [warning for warning in own.warnings if "turns" in warning]


def test_a_gyroscope_that_is_apart_by_itself_follows_the_camera(tmp_path: Path) -> None:
    recording = _copy(tmp_path / "gyro", 0.0, gyro_ahead_s=0.25)
    assert recording.shifts_s == pytest.approx((0.0, 0.25), abs=0.01)
    (said,) = [warning for warning in recording.warnings if "turns" in warning]
    assert said.startswith("By the turns that camera and gyroscope show")


def test_clocks_that_agree_and_a_robot_that_hardly_turns_are_left_as_they_are(tmp_path: Path) -> None:
    assert _copy(tmp_path / "same", 0.0).shifts_s == (0.0, 0.0)
    late = _copy(tmp_path / "late", 0.06)  # as latency is
    assert late.shifts_s == (0.0, 0.0)
    assert any("Say `delay_s: -0.07" in warning for warning in inspect_recording(late).warnings)
    recording = _copy(tmp_path / "straight", 0.3)
    path = tmp_path / "straight" / "wheels.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(f"{row.rpartition(',')[0]},{row.split(',')[1]}" for row in rows), ""]))
    again = open_recording(tmp_path / "straight")
    assert isinstance(again, ImageRecording)
    assert again.shifts_s == (0.0, 0.0) != recording.shifts_s


def test_a_delay_is_calibrated_by_the_wheels_own_stamps(tmp_path: Path) -> None:
    """What a live robot needs, whose clocks are not put on one."""
    trial = try_calibration(_copy(tmp_path / "apart", 0.3), train_share=0.8)
    assert trial.fit.wheels.delay_s == pytest.approx(-0.3, abs=0.03)


def test_of_a_base_that_moves_to_the_side_nothing_is_claimed(sample: tuple[Recording, list[Event]]) -> None:
    """Its way moves the image, too: three simulated drives showed up to 0.06 s that were none."""
    known = sample[0].calibration
    base = HolonomicWheels("mecanum", 0.05, 0.2, 0.18, ticks_per_turn=4096)
    turns = MotionClock(Calibration.registered_camera(not_none(known.color), holonomic=base))
    for event in sample[1]:
        turns.add(WheelCounts(event.stamp_s, (0, 0, 0, 0)) if isinstance(event, WheelTicks) else event)
    assert turns.offset().offset_s is None
    assert "to the side" in turns.offset().why_not


@pytest.mark.parametrize(
    ("agreement", "as_stamped", "removed_s"), [(0.99, 0.94, -0.284), (0.894, 0.749, 0.0), (0.99, 0.97, 0.0)]
)
def test_an_offset_is_removed_only_where_it_explains_clearly_more(
    agreement: float, as_stamped: float, removed_s: float
) -> None:
    """The second: three people pass in a drive whose clocks agree."""
    offset = MotionOffset(-0.284, 0.01, agreement, 4.8, as_stamped=as_stamped)
    assert sure_offset_s(offset) == removed_s
