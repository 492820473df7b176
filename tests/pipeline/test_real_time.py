"""Runs in real time: by virtual time what is dropped and how late answers are; by the host's, wheels from elsewhere."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import astuple, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from pipeline.made import BY_FEATURES, WHEELS, frames_at, metrics_in, mixed_recording, status_in, wheel_recording
from room_drive import make_room_drive
from stand_ins import MemoryRecording, TrueOdometry, frame
from virtual_time import VirtualClock

from wheelsight.app.run import FrameRecord, RealTimeRecording, RunRecord, in_real_time
from wheelsight.app.run.realtime import THREAD, LiveWheels
from wheelsight.app.runs import run, run_each
from wheelsight.app.telemetry import Telemetry
from wheelsight.config import load_config
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ConfigError, DeviceError, RecordingError
from wheelsight.core.messages import RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.devices import TelemetryPipe
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import ListedFrame, Recording, open_recording

JOINED = load_config(overrides={"odometry": "wheels,features"})
BY_PAPER = load_config(overrides={"odometry": "wheels,features", "fusion": "ligocki"})  # asks little of a stand-in
REHEARSED = 3
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


def working(clock: VirtualClock, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let each frame of camera odometry take so long, by the clock."""
    process, calls = TrueOdometry.process, []

    def slow(self: TrueOdometry, frame: RgbdFrame, *others: object) -> object:
        calls.append(frame)
        if len(calls) > REHEARSED:
            clock.sleep(seconds)
        return process(self, frame)

    monkeypatch.setattr(TrueOdometry, "process", slow)


def test_a_slow_tracker_costs_frames_not_delay_and_the_run_says_so(
    clock: VirtualClock, truth: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    period_s = float(np.diff(truth.stamps_s).mean())
    working(clock, monkeypatch, 2.3 * period_s)
    record = run(RealTimeRecording(MemoryRecording(frames_at(truth), truth), clock=clock), BY_FEATURES, tmp_path)
    played = record.realtime
    assert played is not None
    answered = [0, 2, 4, 6, 9, 11, 13, 16, 18, 19]
    assert [frame.index for frame in record.frames] == answered
    assert (played.frames, played.dropped, played.unread) == (20, 20 - len(answered), 0)
    waited = [0, 0.3, 0.6, 0.9, 0.2, 0.5, 0.8, 0.1, 0.4, 1.7]  # periods, the last for the one before
    median, p95 = np.percentile(2.3 + np.array(waited), [50, 95])
    assert played.latency_median_s == pytest.approx(median * period_s)
    assert played.latency_p95_s == pytest.approx(p95 * period_s)
    figures = metrics_in(tmp_path)
    assert figures["realtime"]["dropped"] == played.dropped
    assert figures["frames"]["listed"] == 20
    assert figures["frames"]["processed"] == len(answered)
    dropped = played.dropped + 1  # one image of the recording has no partner
    assert figures["frames"]["dropped"]["total"] == dropped
    (found,) = (one for one in figures["verdict"]["findings"] if one["about"] == "drops")
    assert found["tone"] == "red"
    assert f"{dropped} of 21 frames dropped" in found["sentence"]
    assert "end other programs, or give --profile pi: the computer is too slow" in found["remedy"]
    before = [after - one - 1 for one, after in zip([-1, *answered], answered, strict=False)]
    rows = [int(row["dropped"]) for row in status_in(tmp_path)]
    assert rows == [*before[:-1], before[-1] + 1]
    assert sum(rows) == dropped


def test_a_fast_one_answers_as_a_run_that_takes_its_time(
    clock: VirtualClock, truth: Trajectory, tmp_path: Path
) -> None:
    source = MemoryRecording(frames_at(truth), truth)
    live, calm = (
        run(recording, BY_FEATURES, tmp_path / name)
        for recording, name in ((RealTimeRecording(source, clock=clock), "live"), (source, "calm"))
    )
    assert (tmp_path / "live" / "trajectory.txt").read_bytes() == (tmp_path / "calm" / "trajectory.txt").read_bytes()
    reported = astuple(not_none(live.realtime))
    nothing = pytest.approx(0.0, abs=1e-9)
    assert reported == (pytest.approx(np.ptp(truth.stamps_s)), 20, 0, 0, 0, nothing, nothing, None, False, None)
    assert calm.realtime is None
    assert live.warnings == calm.warnings
    assert "realtime" not in metrics_in(tmp_path / "calm")


def test_decoding_that_is_too_slow_is_distinguished_from_tracking(clock: VirtualClock) -> None:
    class Listed(MemoryRecording):
        """Frames ten a second, each a quarter of a second in decoding."""

        def listed(self) -> Iterator[ListedFrame]:
            for index in range(30):
                yield ListedFrame(0.1 * index, 0.1 * (index + 1), partial(self.decoded, index))

        def decoded(self, index: int) -> RgbdFrame:
            clock.sleep(0.25)
            return frame(index, 0.1 * index)

    live = RealTimeRecording(Listed([frame(0, 0.0)]), clock=clock)
    assert not live.warnings
    assert len(list(live.events())) < 20
    played = live.report()
    assert played.unread > played.dropped / 2  # which the verdict goes by
    lately = live.lately()
    assert lately is not None
    assert lately[0] == pytest.approx(4.0, rel=0.25)


def mounted(recording: MemoryRecording) -> MemoryRecording:
    calibration = replace(recording.calibration, T_base_camera=T_BASE_CAMERA)
    return MemoryRecording(recording.given, None, calibration)


def test_joined_sensors_do_not_follow_the_camera_once_more(
    clock: VirtualClock, truth: Trajectory, tmp_path: Path
) -> None:
    source = mounted(mixed_recording(truth))
    names = [
        record.odometry for record in run_each(RealTimeRecording(source, clock=clock), BY_PAPER, tmp_path / "live")
    ]
    assert names == ["wheels", "joined"]
    assert [record.odometry for record in run_each(source, BY_PAPER, tmp_path / "calm")][-1] == "joined"
    assert set(metrics_in(tmp_path / "live")["odometry"]) == {"wheels", "joined"}


def test_what_breaks_it_off_leaves_what_was_found(clock: VirtualClock, truth: Trajectory, tmp_path: Path) -> None:
    given = [*frames_at(truth)[:7], RecordingError("the disk went away", path="rgb")]
    with pytest.raises(RecordingError, match="the disk went away"):
        run(RealTimeRecording(MemoryRecording(given, truth), clock=clock), BY_FEATURES, tmp_path)
    figures = metrics_in(tmp_path)
    assert figures["interrupted"]
    assert figures["frames"]["processed"] == figures["realtime"]["frames"] == 7
    assert not any(thread.name == THREAD for thread in threading.enumerate())


@pytest.fixture
def ctrl_c_raises() -> Iterator[None]:
    """As in a terminal, wherever tests run."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c_raises")
def test_ctrl_c_while_a_frame_is_waited_for_keeps_what_was_found(truth: Trajectory, tmp_path: Path) -> None:
    a_minute_apart = [replace(event, stamp_s=60.0 * event.index) for event in frames_at(truth)]  # type: ignore[type-var, union-attr]
    monotone = Trajectory(np.array([0.0, 1200.0]), truth.T_frame_body[:2])
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    TrueOdometry.truth = monotone
    live = RealTimeRecording(MemoryRecording(a_minute_apart, monotone))
    with pytest.raises(KeyboardInterrupt):
        run(live, BY_FEATURES, tmp_path, on_frame=lambda _: timer.start())
    figures = metrics_in(tmp_path)
    assert figures["interrupted"]
    assert figures["realtime"]["frames"] == figures["frames"]["processed"] == 1
    assert not any(thread.name == THREAD for thread in threading.enumerate())


def test_ctrl_c_before_time_begins_to_run_leaves_nothing(
    clock: VirtualClock, truth: Trajectory, tmp_path: Path
) -> None:
    given = [*frames_at(truth)[:1], KeyboardInterrupt()]
    with pytest.raises(KeyboardInterrupt):
        run(RealTimeRecording(MemoryRecording(given, truth), clock=clock), BY_FEATURES, tmp_path)
    assert list(tmp_path.iterdir()) == []  # rather than trajectories without a pose, which nothing reads


class Ticking:
    """Ticks every 20 ms of virtual time, stamped by a clock of their own, until the plug is pulled."""

    def __init__(self, clock: VirtualClock, count: int, error: DeviceError | None = None) -> None:
        self.clock, self.count, self.error = clock, count, error

    def ticks(self) -> Iterator[WheelTicks]:
        begin_s = self.clock.now_s()
        for index in range(self.count):
            if self.clock.is_over:
                return
            yield WheelTicks(77.0 + self.clock.now_s() - begin_s, 30 * index, 40 * index)
            self.clock.sleep(0.02)
        if self.error is not None:
            raise self.error

    def close(self) -> None:
        self.clock.end()


def live_run(clock: VirtualClock, source: Ticking, recording: Recording, out: Path) -> dict[str, RunRecord]:
    with LiveWheels("pipe", clock=clock, source=source) as wheels:
        records = run_each(RealTimeRecording(recording, wheels, clock), BY_PAPER, out)
    return {record.odometry: record for record in records}


def test_live_wheels_are_stamped_by_the_recordings_clock_and_the_recordings_own_left_out(
    clock: VirtualClock, truth: Trajectory, tmp_path: Path
) -> None:
    source = mounted(mixed_recording(truth))
    records = live_run(clock, Ticking(clock, 10_000), source, tmp_path)
    wheels = records["wheels"]
    stamps_s = [frame.stamp_s for frame in wheels.frames]
    begin_s, end_s = truth.stamps_s[[0, -1]]
    assert begin_s <= stamps_s[0] < begin_s + 0.021
    assert end_s - 0.021 < stamps_s[-1] <= end_s
    np.testing.assert_allclose(np.diff(stamps_s), 0.02, atol=1e-6)
    played = records["joined"].realtime
    assert played is not None
    assert (played.readings, played.wheels_from) == (len(stamps_s), "pipe")
    assert metrics_in(tmp_path)["odometry"]["wheels"]["wheel_readings"]["listed"] == len(stamps_s)
    assert not any("silent" in warning for warning in records["joined"].warnings)


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (None, "its other end was closed"),
        (DeviceError("a line is no telemetry", path="pipe"), "a line is no telemetry"),
    ],
)
def test_wheels_that_fall_silent_do_not_end_the_run(
    clock: VirtualClock, truth: Trajectory, tmp_path: Path, error: DeviceError | None, why: str
) -> None:
    records = live_run(clock, Ticking(clock, 12, error), mounted(mixed_recording(truth)), tmp_path)
    assert len(records["wheels"].frames) <= 12
    assert len(records["joined"].frames) == 20
    said = f"The wheels (pipe) fell silent after {len(records['wheels'].frames)} readings: {why}."
    assert said in records["joined"].warnings


def test_wheels_that_never_speak_are_reported_of(clock: VirtualClock, truth: Trajectory, tmp_path: Path) -> None:
    records = live_run(clock, Ticking(clock, 0), mounted(mixed_recording(truth)), tmp_path)
    assert records["wheels"].frames == ()
    assert any("fell silent after 0 readings" in warning for warning in records["joined"].warnings)


def test_counters_of_live_wheels_do_not_roll_over(truth: Trajectory, clock: VirtualClock) -> None:
    calibration = replace(mixed_recording(truth).calibration, wheels=replace(WHEELS, counter_bits=16))
    recording = MemoryRecording(frames_at(truth), truth, calibration)
    with LiveWheels("pipe", clock=clock, source=Ticking(clock, 0)) as wheels:
        assert RealTimeRecording(recording, wheels).calibration.wheels == replace(WHEELS, counter_bits=0)
    assert RealTimeRecording(recording).calibration is calibration


def test_wheels_need_frames_beside_them(clock: VirtualClock) -> None:
    wheels = LiveWheels("pipe", clock=clock, source=Ticking(clock, 0))
    with wheels, pytest.raises(ConfigError, match="no images to play beside the wheels"):
        RealTimeRecording(wheel_recording(), wheels)


def test_a_source_whose_clock_begins_again_or_says_nonsense_is_passed_on(clock: VirtualClock) -> None:
    heard: list[float] = []
    said = [5.0, 5.1, float("nan"), 1.0, 1.1]

    class Odd:
        def ticks(self) -> Iterator[WheelTicks]:
            for stamp_s in said:
                clock.sleep(0.1)
                yield WheelTicks(stamp_s, 0, 0)

        def close(self) -> None: ...

    begin_s = clock.now_s()

    def hear(ticks: WheelTicks) -> bool:
        heard.append(ticks.stamp_s - begin_s)
        return True

    with LiveWheels("pipe", clock=clock, source=Odd()) as wheels:
        wheels.set_listener(hear)
        clock.sleep(1.0)
    np.testing.assert_allclose(heard, [0.1, 0.2, np.nan, 0.4, 0.5])
    assert wheels.count == 5


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "drive"
    make_room_drive(folder, frames=4)
    return folder


class AfterReadings:
    """Does something once, when so many wheel readings were answered."""

    def __init__(self, count: int, then: object) -> None:
        self.count, self.then = count, then

    def __call__(self, answers: Mapping[str, FrameRecord]) -> None:
        self.count -= "wheels" in answers
        if self.count == 0 and callable(self.then):
            self.then()
            self.then = None


@pytest.mark.usefixtures("real_odometry")
def test_a_telemetry_pipe_whose_writer_goes_away(drive: Path, tmp_path: Path) -> None:
    is_over = threading.Event()
    sent: list[WheelTicks] = []

    def write() -> None:
        telemetry = Telemetry(Wheels(0.17, 0.17, 0.52, 3200.0, counter_bits=32))
        with TelemetryPipe(tmp_path / "pipe") as pipe:
            while not is_over.wait(0.01):
                sent.append(WheelTicks(7e6 + time.monotonic(), 3 * len(sent), 3 * len(sent)))
                pipe.send(telemetry.line(sent[-1]))

    writer = threading.Thread(target=write)
    writer.start()
    while not (tmp_path / "pipe").exists():
        time.sleep(0.01)
    recording = open_recording(drive)
    with in_real_time(recording, str(tmp_path / "pipe")) as live:
        wheels, joined = run_each(live, JOINED, tmp_path / "out", on_event=AfterReadings(10, is_over.set))
    writer.join()
    assert 10 <= len(wheels.frames) <= len(sent)
    assert joined.realtime is not None
    assert joined.realtime.frames == recording.frame_count
    assert any(warning.endswith("readings: its other end was closed.") for warning in joined.warnings)


@pytest.mark.usefixtures("real_odometry")
def test_a_serial_port_that_is_unplugged(drive: Path, tmp_path: Path) -> None:
    with SimulatedController(tmp_path) as controller:
        controller.speeds = (10, 10)
        with in_real_time(open_recording(drive), str(controller.port)) as live:
            wheels, joined = run_each(live, JOINED, tmp_path / "out", on_event=AfterReadings(10, controller.unplug))
    assert len(wheels.frames) >= 10
    assert wheels.estimate.length_m > 0.02
    stamps_s = [frame.stamp_s for frame in wheels.frames]
    assert np.diff(stamps_s).min() > 0
    first_s = next(event.stamp_s for event in open_recording(drive).events())
    assert first_s - 0.05 < stamps_s[0]
    assert any(warning.endswith("readings: the port vanished.") for warning in joined.warnings)
    assert joined.frames[-1].stamp_s > stamps_s[-1]
