"""Stamps of bags: images that are received apart, receipts of any kind, clocks that are apart, set, or wrong once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from written_bags import (
    COLOR,
    DEPTH,
    OPTICAL,
    START_S,
    Drive,
    camera_drive,
    circle,
    color_image,
    depth_mm,
)

from wheelsight.core.errors import RecordingError
from wheelsight.core.messages import RgbdFrame, WheelSpeeds, YawRate
from wheelsight.io.recordings.bags.stamps import TopicClock
from wheelsight.io.recordings.bags.storage import Message
from wheelsight.io.recordings.inspection import inspect_recording

ODOM, IMU = "/odom", "/imu"
# 5 Hz is here for its depth received 0.1 s late, 15 for a pause's sake; their images take longest to write.
FAST = [pytest.param(camera_hz, marks=pytest.mark.slow) for camera_hz in (5.0, 15.0)]
Received = Callable[[float, str], float]


def on_time(taken_s: float, topic: str) -> float:
    return taken_s + {COLOR: 0.04, DEPTH: 0.05}.get(topic, 0.002)


def timed_drive(
    camera_hz: float = 2.0,
    seconds: float = 8.0,
    received: Received = on_time,
    headers: Received = lambda taken_s, topic: taken_s,
    **others: Any,
) -> Drive:
    """Camera, odometry at 25 Hz and an IMU at 10 Hz, and when each was received and what its header says.

    `others`: `pause`, (begin, end) of a time without images; `without`, topics.
    """
    drive = camera_drive(frames=0)
    make: Any = drive.make
    begin, end = others.get("pause", (0.0, 0.0))
    drive.add(0.0, "/camera/color/camera_info", make.info(OPTICAL))

    taken: list[tuple[float, str, Any]] = []

    def add(taken_s: float, topic: str, made: Callable[..., Any]) -> None:
        taken.append((taken_s, topic, made(headers(taken_s, topic))))

    for number, at_s in enumerate(np.arange(0.1, seconds, 1 / camera_hz).tolist()):
        if not begin <= at_s < end:
            add(at_s, COLOR, lambda s, n=number: make.image(s, OPTICAL, "rgb8", color_image(n)))
            add(at_s, DEPTH, lambda s, n=number: make.image(s, OPTICAL, "16UC1", depth_mm(n)))
    for at_s in np.arange(0, seconds, 0.04).tolist():
        add(at_s, ODOM, lambda s, at_s=at_s: make.odometry(s, circle(at_s), (0.5, 0.3)))
    for at_s in np.arange(0, seconds, 0.1).tolist():
        add(at_s, IMU, lambda s: make.imu(s, "base_link", (0, 0, 0.3), (0, 0, 9.81)))
    for taken_s, topic, message in sorted(taken, key=lambda item: on_time(item[0], item[1])):
        drive.add(received(taken_s, topic), topic, message)
    return drive.without(*others.get("without", ()))


def stamps_of(recording: Any, kind: Any) -> np.ndarray:
    """Seconds since the drive began of all events of a kind."""
    return np.array([event.stamp_s for event in recording.events() if isinstance(event, kind)]) - START_S


def expected(kind: type, seconds: float = 8.0, camera_hz: float = 2.0) -> np.ndarray:
    first_s, step_s = {RgbdFrame: (0.1, 1 / camera_hz), WheelSpeeds: (0, 0.04), YawRate: (0, 0.1)}[kind]
    return np.arange(first_s, seconds, step_s)


def check_all(recording, seconds: float = 8.0, camera_hz: float = 2.0, atol: float = 2e-6) -> None:
    for kind in (RgbdFrame, WheelSpeeds, YawRate):
        np.testing.assert_allclose(stamps_of(recording, kind), expected(kind, seconds, camera_hz), atol=atol)


def about_time(recording) -> list[str]:
    """Warnings after a pass that are about clocks and losses."""
    words = ("header", "clock", "lost", "left out", "receipt")
    return [warning for warning in recording.warnings if any(word in warning for word in words)]


@pytest.mark.parametrize("camera_hz", [1.0, 2.0, 3.0, *FAST])
@pytest.mark.parametrize("depth_late_s", [-0.1, -0.03, 0.03, 0.1])
def test_slow_cameras_lose_no_pair_however_late_depth_is_received(
    opened, camera_hz: float, depth_late_s: float
) -> None:
    def received(taken_s: float, topic: str) -> float:
        return on_time(taken_s, topic) + 0.1 + (depth_late_s if topic == DEPTH else 0)

    recording = opened(timed_drive(camera_hz, received=received))
    check_all(recording, camera_hz=camera_hz)
    assert recording.association.unpaired == 0
    assert about_time(recording) == []


def test_a_pause_costs_no_frame(opened) -> None:
    recording = opened(timed_drive(15.0, pause=(2.0, 6.0)))
    taken_s = expected(RgbdFrame, camera_hz=15.0)
    np.testing.assert_allclose(
        stamps_of(recording, RgbdFrame), taken_s[(taken_s < 2) | (taken_s >= 6)], rtol=0, atol=2e-6
    )
    assert len(stamps_of(recording, WheelSpeeds)) == 200
    assert about_time(recording) == []


def test_lost_pairs_are_warned_of_with_reason_and_counts(opened) -> None:
    drive = timed_drive(10.0, headers=lambda s, topic: s + (0.03 if topic == DEPTH and round(s * 10) % 5 == 2 else 0))
    recording = opened(drive)
    assert len(stamps_of(recording, RgbdFrame)) == 63
    (found,) = [warning for warning in inspect_recording(recording).warnings if "lost" in warning]
    assert found.startswith("16 of 79 frames were lost: 16 colour and 16 depth images stayed single")
    assert "the nearest is 0.030 s away" in found
    assert "raise --max-gap" in found


def test_depth_at_a_lower_rate_than_colour_loses_nothing(opened) -> None:
    drive = timed_drive(10.0)
    dropped = [number for number, item in enumerate(drive.messages) if item[1] == DEPTH][::2]
    drive.messages = [item for number, item in enumerate(drive.messages) if number not in dropped]
    recording = opened(drive)
    assert len(stamps_of(recording, RgbdFrame)) == 39
    assert about_time(recording) == []


def test_a_refusal_names_the_largest_gap_only_where_it_is_the_cause(opened) -> None:
    with pytest.raises(RecordingError, match=r"the nearest is 0\.050 s away.*raise --max-gap"):
        opened(timed_drive(headers=lambda s, topic: s + (0.05 if topic == DEPTH else 0)))
    with pytest.raises(RecordingError, match="no depth image lies within") as refused:
        opened(timed_drive(headers=lambda s, topic: s + (4.07 if topic == DEPTH else 0)))
    assert "max-gap" not in str(refused.value)


def jittering(taken_s: float, topic: str) -> float:
    """Up to 0.3 s late, images more than readings, never out of order."""
    return taken_s + 0.15 * (1 + np.sin(3 * taken_s + len(topic))) * (1.0 if topic in (COLOR, DEPTH) else 0.3)


RECEIPTS: dict[str, Received] = {
    "slow simulator": lambda s, topic: 1000 + on_time(s, topic) / 0.22,
    "simulator of varying speed": lambda s, topic: 1000 + 3 * s - 2 * np.cos(s) + on_time(0, topic),
    "fast simulator": lambda s, topic: on_time(s / 5, topic),
    "very fast simulator": lambda s, topic: on_time(s / 20, topic),
    "recorder before /clock": lambda s, topic: 0.0 if s < 0.3 else on_time(s, topic),
    "recorder long before /clock": lambda s, topic: -1000.0 if s < 4 else on_time(s, topic),
    "replay": lambda s, topic: on_time(s, topic) + 5000,
    "recorder set forward": lambda s, topic: on_time(s, topic) + (60 if s > 4 else 0),
    "jitter": jittering,
    "bursts": lambda s, topic: on_time(np.ceil(s / 1.5) * 1.5, topic) + 1e-4 * s,
    "one topic late": lambda s, topic: on_time(s, topic) + (0.4 if topic in (COLOR, DEPTH) else 0),
    "a stall of one topic": lambda s, topic: on_time(max(s, 6.0) if topic in (COLOR, DEPTH) and s > 3 else s, topic),
    "all at once": lambda s, topic: 1e-4 * s,
}


@pytest.mark.parametrize("camera_hz", [2.0, *FAST[:1]])
@pytest.mark.parametrize("received", RECEIPTS.values(), ids=RECEIPTS.keys())
def test_with_clean_headers_receipt_does_not_matter(opened, received: Received, camera_hz: float) -> None:
    recording = opened(timed_drive(camera_hz, received=received))
    check_all(recording, camera_hz=camera_hz)
    assert not [w for w in about_time(recording) if "left out" in w or "removed" in w or "receipt is used" in w]


@pytest.mark.parametrize("apart_s", [-30, -3, -1, 1, 3, 30])
@pytest.mark.parametrize("camera_hz", [2.0, *FAST[:1]])
def test_a_cameras_clock_that_is_apart_is_taken_out_and_named(opened, apart_s: int, camera_hz: float) -> None:
    recording = opened(timed_drive(camera_hz, headers=lambda s, t: s + (apart_s if t in (COLOR, DEPTH) else 0)))
    # To within what an image takes to be received.
    check_all(recording, camera_hz=camera_hz, atol=0.06)
    np.testing.assert_allclose(np.diff(stamps_of(recording, RgbdFrame)), 1 / camera_hz, atol=1e-5)
    (found,) = [warning for warning in recording.warnings if warning.startswith(f"{COLOR}: ")]
    said_s = float(found.split("headers are ")[1].split(" s ")[0])
    assert said_s == pytest.approx(abs(apart_s), abs=0.06)
    assert ("after" in found) == (apart_s > 0)
    assert found in inspect_recording(recording).warnings


def test_wheels_that_are_apart_from_camera_and_gyroscope_follow_these(opened) -> None:
    recording = opened(timed_drive(headers=lambda s, topic: s + (2 if topic == ODOM else 0)))
    check_all(recording, atol=0.06)
    assert any(warning.startswith(f"{ODOM}: headers are 2.0") for warning in recording.warnings)


@pytest.mark.parametrize("by_s", [-20.0, -3.0, -1.0, -0.7, 0.8, 1.0, 3.0, 60.0])
@pytest.mark.parametrize(
    "topics", [(COLOR, DEPTH), (ODOM,), (COLOR, DEPTH, ODOM, IMU)], ids=["camera", "wheels", "all"]
)
def test_a_clock_that_is_set_is_taken_out_and_named(opened, by_s: float, topics: tuple[str, ...]) -> None:
    recording = opened(timed_drive(headers=lambda s, topic: s + (by_s if topic in topics and s > 4.02 else 0)))
    check_all(recording, atol=0.05)
    found = [warning for warning in recording.warnings if "the clock was set" in warning]
    assert {warning.partition(":")[0] for warning in found} == set(topics)
    way = "forward" if by_s > 0 else "back"
    assert all(f"set {way} by {abs(by_s):.1f}" in w or f"set {way} by {abs(by_s) - 0.1:.1f}" in w for w in found)


def test_a_leap_that_receipt_shares_is_no_setting(opened) -> None:
    """The robot and its recorder paused for a minute."""
    leap: Received = lambda s, topic: s + (60 if s > 4.02 else 0)  # noqa: E731
    recording = opened(timed_drive(headers=leap, received=lambda s, topic: on_time(leap(s, topic), topic)))
    frames_s = expected(RgbdFrame)
    np.testing.assert_allclose(stamps_of(recording, RgbdFrame), frames_s + 60 * (frames_s > 4.02), atol=2e-6)
    assert len(stamps_of(recording, WheelSpeeds)) == 200


WRONG = {
    "one ahead": {4.0: 6.0},
    "one far ahead": {4.0: 5000.0},
    "one behind": {4.0: -6.0},
    "one little behind": {4.0: -0.5},
    "the first": {0.0: 6.0},
    "the first far behind": {0.0: -1000.0},
    "the last": {7.96: 6.0},
    "several": {1.0: 6.0, 2.0: -3.0, 4.0: 2.5, 4.04: 2.5, 6.0: 0.7},
    "three in a row": {4.0: 6.0, 4.04: 6.0, 4.08: 6.0},
    "several at first": {0.0: 6.0, 0.08: -6.0},
}


@pytest.mark.parametrize("without", [(), (COLOR, DEPTH, IMU)], ids=["all", "wheels alone"])
@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG.keys())
def test_wrong_stamps_are_left_out_alone_and_counted(opened, wrong: dict[float, float], without) -> None:
    def headers(taken_s: float, topic: str) -> float:
        return taken_s + (wrong.get(round(taken_s, 3), 0.0) if topic == ODOM else 0)

    recording = opened(timed_drive(headers=headers, without=without))
    right_s = [taken_s for taken_s in expected(WheelSpeeds) if round(taken_s, 3) not in wrong]
    np.testing.assert_allclose(stamps_of(recording, WheelSpeeds), right_s, atol=2e-6)
    assert any(warning.startswith(f"{ODOM}: {len(wrong)} messages were left out") for warning in recording.warnings)
    inspection = inspect_recording(recording)
    assert inspection.wheel_readings == 200 - len(wrong)
    why = f"{ODOM}: headers fit neither their neighbours nor receipt"
    assert (why, len(wrong), 200) in inspection.left_out
    if not without:
        np.testing.assert_allclose(stamps_of(recording, RgbdFrame), expected(RgbdFrame), atol=2e-6)


@pytest.mark.parametrize("by_s", [-6.0, -1.0, 1.0, 6.0])
def test_a_wrong_stamp_of_a_colour_image_loses_its_frame_alone(opened, by_s: float) -> None:
    recording = opened(timed_drive(2.0, headers=lambda s, t: s + (by_s if t == COLOR and 3.9 < s < 4.2 else 0)))
    right_s = [taken_s for taken_s in expected(RgbdFrame, camera_hz=2.0) if not 3.9 < taken_s < 4.2]
    np.testing.assert_allclose(stamps_of(recording, RgbdFrame), right_s, atol=2e-6)
    assert len(stamps_of(recording, WheelSpeeds)) == 200
    assert any(warning.startswith("1 of 16 frames were lost") for warning in recording.warnings)


def test_headers_that_stand_still_give_way_to_receipt(opened) -> None:
    recording = opened(timed_drive(headers=lambda s, topic: 1.0 if topic in (COLOR, DEPTH) else s))
    with_receipt_s = expected(RgbdFrame) + 0.04
    np.testing.assert_allclose(stamps_of(recording, RgbdFrame), with_receipt_s, atol=2e-6)
    assert any("do not grow as a clock does" in warning for warning in recording.warnings)


def test_readings_that_were_received_out_of_order_are_all_used(opened) -> None:
    drive = timed_drive(received=lambda s, topic: on_time(s, topic) + (0.05 if round(s / 0.04) % 7 == 3 else 0))
    check_all(opened(drive))


@pytest.mark.parametrize("speed", [0.22, 1.0, 5.0])
@pytest.mark.parametrize("rate_hz", [1, 5, 50])
def test_clean_headers_stay_as_they_are_and_wrong_ones_among_them_go(speed: float, rate_hz: int) -> None:
    random = np.random.default_rng(rate_hz)
    for _ in range(10):
        clean_s = 100 + (np.arange(120) + random.uniform(-0.2, 0.2, 120)) / rate_hz
        received_s = np.maximum.accumulate(clean_s / speed + np.abs(random.normal(0, 0.05, 120)))
        wrong = np.zeros(120, bool)
        wrong[random.choice(np.arange(20, 100), 2, replace=False)] = True
        for headers_s, right in ((clean_s, np.ones(120, bool)), (clean_s + wrong * random.choice([-30, 30]), ~wrong)):
            clock = TopicClock()
            settled = [
                one
                for header_s, receipt_s in zip(headers_s.tolist(), received_s.tolist(), strict=True)
                for one in clock.add(header_s, Message(ODOM, round(1e9 * receipt_s), b""))
            ]
            settled += clock.end()
            np.testing.assert_array_equal([stamp_s for stamp_s, _ in settled], clean_s[right])
            assert (clock.left_out, clock.settings) == (120 - right.sum(), [])


@pytest.mark.parametrize("camera_hz", [2.0, *FAST[1:]])
@pytest.mark.parametrize("by_s", [2.0, 3.0])
def test_a_recorder_whose_clock_is_set_back_loses_nothing(opened, by_s: float, camera_hz: float) -> None:
    """What comes then is received at the times of what came before: both are mixed in the bag."""
    drive = timed_drive(camera_hz, 12.0, lambda s, topic: on_time(s, topic) - (by_s if s >= 7 else 0))
    recording = opened(drive)
    for kind in (RgbdFrame, WheelSpeeds, YawRate):
        np.testing.assert_allclose(stamps_of(recording, kind), expected(kind, 12.0, camera_hz), atol=2e-6)
    reported = [warning for warning in recording.warnings if "clock of the recorder was set back" in warning]
    assert {warning.split(":")[0] for warning in reported} == {COLOR, DEPTH, ODOM, IMU}
    assert not any("left out" in warning or "lost" in warning for warning in recording.warnings)
